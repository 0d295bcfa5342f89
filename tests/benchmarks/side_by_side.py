"""The demo's keyframes mapped by OpenCV's stitcher, pycolmap, the chain of homographies, and us, in one run.

Every map is judged by its landmark positions after a least-squares similarity. The order of two accurate maps
varies from flight to flight, so there are several flights; the stitcher, which is the slowest and far less
accurate, maps only the first. OpenCV's stitcher and pycolmap run in separate processes with a time limit,
since both match exhaustively. Pycolmap gets the true intrinsics, as we do, but neither heights nor the flat
floor; a landmark is the point nearest to its rays.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.streams import Frames
from slam.evaluation.association import associate
from slam.evaluation.landmarks import seen_at
from slam.evaluation.trajectory import umeyama
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from slam.simulation import simulate
from tests.benchmarks.by_pycolmap import mapped_apart
from tests.benchmarks.by_stitcher import stitched_apart
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most, reported

Array = NDArray[np.float64]

SEEDS = (0, 1, 2, 3, 4)
LIMIT_S = 600.0
"""Time limit in seconds for one flight."""


@dataclass(frozen=True)
class Sighting:
    """One observation of a landmark in a keyframe."""

    name: str
    keyframe: int
    pixel: Array
    """(1, 2) pixel."""


@dataclass(frozen=True)
class Verdict:
    """Accuracy of one map."""

    landmarks: int
    in_place: int
    """Number of those that are nearer to their own true position than to any other."""
    rms_m: float
    """RMS error of the landmarks' positions."""
    largest_percent: float
    """RMS error of the distances between named pairs."""


@dataclass(frozen=True)
class Scene:
    """Input of all methods, and their reference."""

    flight: Flight
    camera: Camera
    pictures: Path
    """Folder of the keyframes in order of time."""
    sightings: list[Sighting]

    def judged(self, places: Array) -> Verdict:
        """Landmarks at the mean of their (m, 2) places in each sighting, against the truth."""
        names = list(self.flight.landmarks)
        mean = np.full((len(names), 3), np.nan)
        for row, mine in enumerate(self.by_landmark()):
            known = places[mine][np.isfinite(places[mine]).all(axis=1)]
            if len(known):
                mean[row] = np.append(known.mean(axis=0), 0.0)
        return judge(self.flight, mean)

    def by_landmark(self) -> list[list[int]]:
        """Numbers of the sightings of each landmark."""
        return [[n for n, s in enumerate(self.sightings) if s.name == name] for name in self.flight.landmarks]


@dataclass(frozen=True)
class Ours:
    """Our results on a flight's keyframes."""

    scene: Scene
    map: Verdict
    chain: Verdict
    placed: int
    seconds: float
    """Seconds, including the mosaic."""
    chain_seconds: float
    """Seconds, without a mosaic."""


def measure() -> list[Metric]:
    """Return time, topology and landmark error of the four methods."""
    with tempfile.TemporaryDirectory() as folder:
        ours = [mapped_by_us(seed, Path(folder) / str(seed)) for seed in SEEDS]
        rivals = [*beside_stitcher(ours[0]), *beside_pycolmap(ours)]
    return [
        *figures_of("ours", [o.map for o in ours]),
        *figures_of("chain of homographies", [o.chain for o in ours]),
        reported(
            "ours: keyframes placed", sum(o.placed for o in ours), "", f"of {sum(map(keyframes, ours))}"
        ),
        reported("ours: time, mosaics included", sum(o.seconds for o in ours), "s", f"{len(ours)} flights"),
        reported("chain of homographies: time, without a mosaic", sum(o.chain_seconds for o in ours), "s"),
        *rivals,
    ]


def mapped_by_us(seed: int, folder: Path) -> Ours:
    """Fly, keep the keyframes, map them; pictures for the others go below ``folder``."""
    flight = keyframes_of(simulate("figure_eight", seed))
    assert flight.frames is not None
    assert flight.camera is not None
    pictures = folder / "keyframes"
    pictures.mkdir(parents=True)
    for k, frame in enumerate(flight.frames):
        cv2.imwrite(str(pictures / f"{k:05d}.png"), frame.read())
    began = time.perf_counter()
    estimate = optimize(flight)
    write_mosaic(estimate, flight, folder)
    seconds = time.perf_counter() - began
    truth = associate(estimate, flight).w_T_b
    assert truth is not None
    scene = Scene(flight, flight.camera, pictures, landmarks_seen(flight.landmarks, flight.camera, truth))
    of_map, of_chain = (
        scene.judged(over_floor(scene.sightings, flight.camera, w_T_b))
        for w_T_b in (estimate.w_T_b, estimate.chain_w_T_b)
    )
    placed = int((estimate.component == 0).sum())
    return Ours(scene, of_map, of_chain, placed, seconds, estimate.timing_s["track"])


def keyframes(ours: Ours) -> int:
    """Return the number of pictures that all methods get."""
    assert ours.scene.flight.frames is not None
    return len(ours.scene.flight.frames)


def beside_stitcher(ours: Ours) -> list[Metric]:
    """Run OpenCV's stitcher for scans."""
    scene = ours.scene
    made = stitched_apart(scene.pictures, LIMIT_S)
    on_canvas = [
        carried(made.canvas_H[s.keyframe], s.pixel) if s.keyframe in made.canvas_H else np.full(2, np.nan)
        for s in scene.sightings
    ]
    name = "cv2.Stitcher (SCANS), first flight"
    return [
        reported(f"{name}: time, mosaic included", made.seconds, "s", made.status),
        at_most(
            "our time over cv2.Stitcher's", ours.seconds / made.seconds, "x", 1.0, f"{ours.seconds:.0f} s"
        ),
        *figures_of(name, [scene.judged(np.array(on_canvas))]),
    ]


def beside_pycolmap(ours: list[Ours]) -> list[Metric]:
    """Run structure from motion with the known camera, without a mosaic."""
    name = "pycolmap"
    try:
        made = [mapped_apart(o.scene.pictures, o.scene.camera, LIMIT_S) for o in ours]
    except Skipped as skipped:
        return [reported(f"{name}: keyframes placed", float("nan"), "", str(skipped))]
    pairs = [(o, m) for o, m in zip(ours, made, strict=True) if m is not None]
    theirs = [judge(o.scene.flight, nearest_to_rays(o.scene, m.c_T_w)) for o, m in pairs]
    placed, late = sum(len(m.c_T_w) for _, m in pairs), LIMIT_S * (len(ours) - len(pairs))
    seconds = sum(m.seconds for _, m in pairs) + late
    both = [(o.map.rms_m, t.rms_m) for (o, _), t in zip(pairs, theirs, strict=True) if t.rms_m > 0]
    ratio = rms([a for a, _ in both]) / rms([b for _, b in both])
    listed = ", ".join(f"{1e3 * a:.2f} over {1e3 * b:.2f} mm" for a, b in both)
    return [
        reported(f"{name}: flights without an answer within {LIMIT_S:.0f} s", len(ours) - len(pairs), ""),
        reported(f"{name}: keyframes placed", placed, "", "in the largest of its models, intrinsics given"),
        at_least(
            "our keyframes placed over pycolmap's", sum(o.placed for o in ours) / max(placed, 1), "x", 1.0
        ),
        reported(f"{name}: time, without mosaics, CPU", seconds, "s"),
        at_most(
            "our time, mosaics included, over pycolmap's", sum(o.seconds for o in ours) / seconds, "x", 1.0
        ),
        *figures_of(name, theirs),
        at_most("our RMS of landmark places over pycolmap's", ratio, "x", 1.0, listed),
    ]


def nearest_to_rays(scene: Scene, c_T_w: dict[str, Array]) -> Array:
    """(landmarks, 3): the point nearest to all rays to a landmark, in the model's world; NaN below two."""
    numbers = {int(Path(name).stem): pose for name, pose in c_T_w.items()}
    points = np.full((len(scene.flight.landmarks), 3), np.nan)
    for row, mine in enumerate(scene.by_landmark()):
        normal, right, rays = np.zeros((3, 3)), np.zeros(3), 0
        for s in (scene.sightings[n] for n in mine):
            if s.keyframe in numbers:
                R, t = numbers[s.keyframe][:, :3], numbers[s.keyframe][:, 3]
                ray = R.T @ scene.camera.rays(s.pixel)[0]
                across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
                normal, right, rays = normal + across, right + across @ (-R.T @ t), rays + 1
        if rays >= 2:
            points[row] = np.linalg.solve(normal, right)
    return points


def figures_of(name: str, verdicts: list[Verdict]) -> list[Metric]:
    """Return the figures of one method's maps, one for each flight."""
    count, in_place = sum(v.landmarks for v in verdicts), sum(v.in_place for v in verdicts)
    key = f"{name}: landmarks in their place, of {count}"
    known = [f"{1e3 * v.rms_m:.2f}" for v in verdicts if np.isfinite(v.rms_m)]
    each = f"{', '.join(known)} mm" if known else ""
    largest = max((v.largest_percent for v in verdicts), default=float("nan"))
    return [
        at_least(key, in_place, "", count) if name == "ours" else reported(key, in_place, ""),
        reported(
            f"{name}: RMS of landmark places after a similarity", rms([v.rms_m for v in verdicts]), "m", each
        ),
        reported(f"{name}: largest landmark error", largest, "%", "of a named distance, after a similarity"),
    ]


def rms(values: list[float]) -> float:
    """Return the root mean square; NaN for no values."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def keyframes_of(flight: Flight) -> Flight:
    """Return the flight with only the pictures that are keyframes of the demo."""
    assert flight.frames is not None
    frames, index = flight.frames, optimize(flight).frame_index
    images = [frames.load(int(k)) for k in index]
    names = tuple(frames.names[k] for k in index)
    return replace(
        flight, frames=Frames(frames.stamps_s[index], names, images.__getitem__), all_keyframes=True
    )


def landmarks_seen(landmarks: dict[str, Array], camera: Camera, w_T_b: Array) -> list[Sighting]:
    """Return the pixel of each landmark in the true camera."""
    found = []
    for name, w_p in landmarks.items():
        pixel, seen = seen_at(camera, w_T_b, w_p)
        found += [Sighting(name, int(k), pixel[k : k + 1]) for k in np.flatnonzero(seen)]
    return found


def over_floor(sightings: list[Sighting], camera: Camera, w_T_b: Array) -> Array:
    """Return (m, 2) the floor position of each observation by a map's poses."""
    return np.array([camera.floor_points(w_T_b[s.keyframe], s.pixel)[0] for s in sightings])


def carried(H: Array, pixel: Array) -> Array:
    """Return (2,) the position of a pixel on the canvas."""
    u, v, w = H @ np.append(pixel[0], 1.0)
    return np.array([u / w, v / w])


def judge(flight: Flight, mean: Array) -> Verdict:
    """Landmarks at (n, 3) places of a map, NaN where unknown, against the truth."""
    names = list(flight.landmarks)
    true = np.array(list(flight.landmarks.values()))
    known = np.isfinite(mean).all(axis=1)
    if known.sum() < 3:
        return Verdict(len(names), 0, float("nan"), float("nan"))
    # Turned about an axis in the plane it is a reflection too: a canvas seen from below is no error.
    at = umeyama(mean[known], true[known], with_scale=True).apply(mean)
    distance = np.linalg.norm(at[:, None] - true[None], axis=2)
    errors = []
    for a, b in flight.landmark_pairs:
        i, j = names.index(a), names.index(b)
        length = np.linalg.norm(true[j] - true[i])
        errors.append(100 * abs(np.linalg.norm(at[j] - at[i]) - length) / length)
    nearest = np.array([np.argmin(row) if np.isfinite(row).all() else -1 for row in distance])
    off = np.linalg.norm(at - true, axis=1)[known]
    return Verdict(
        len(names),
        int((nearest == np.arange(len(names))).sum()),
        float(np.sqrt(np.mean(off**2))),
        float(np.nanmax(errors)),
    )
