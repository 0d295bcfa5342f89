"""The demo's keyframes mapped by OpenCV's stitcher, pycolmap, the chain of homographies, and us, in one run.

Every map is judged in the same way: where it has the landmarks, after the similarity of least squares.
OpenCV's stitcher and pycolmap run in processes of their own with a time limit: both compare every picture
with every other. Pycolmap is given the true intrinsics, as we are; it is told neither heights nor that the
floor is flat, and a landmark is where its rays come nearest to each other.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.evaluation.association import associate
from slam.evaluation.landmarks import seen_at
from slam.evaluation.trajectory import umeyama
from slam.flight import Flight, Frames
from slam.pipeline import optimize
from slam.rasters.mosaic import write_mosaic
from slam.simulation import simulate
from tests.benchmarks.apart import run_apart
from tests.benchmarks.by_pycolmap import mapped_apart
from tests.benchmarks.metric import Metric, Skipped, at_least, at_most, told

Array = NDArray[np.float64]

_ME = "tests.benchmarks.side_by_side"
LIMIT_S = 1200.0


@dataclass(frozen=True)
class Sighting:
    """A landmark in a keyframe."""

    name: str
    keyframe: int
    pixel: Array
    """(1, 2)."""


@dataclass(frozen=True)
class Verdict:
    """How good one map is."""

    in_place: int
    """Landmarks that lie nearer to their own true place than to any other's."""
    rms_m: float
    """Of the landmarks' places."""
    largest_percent: float
    """Of the distances between named pairs."""


@dataclass(frozen=True)
class Scene:
    """What all are given, and what they are judged by."""

    flight: Flight
    camera: Camera
    pictures: Path
    """Folder of the keyframes, in order."""
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


def measure() -> list[Metric]:
    """Time, topology and landmark error of the four."""
    flight = keyframes_of(simulate("figure_eight", 0))
    assert flight.frames is not None
    assert flight.camera is not None
    began = time.perf_counter()
    estimate = optimize(flight)
    with tempfile.TemporaryDirectory() as folder:
        write_mosaic(estimate, flight, Path(folder))
        ours_s = time.perf_counter() - began
        pictures = Path(folder) / "keyframes"
        pictures.mkdir()
        for k, frame in enumerate(flight.frames):
            cv2.imwrite(str(pictures / f"{k:05d}.png"), frame.read())
        truth = associate(estimate, flight).w_T_b
        assert truth is not None
        scene = Scene(flight, flight.camera, pictures, landmarks_seen(flight.landmarks, flight.camera, truth))
        rivals = beside_stitcher(scene, ours_s)
        ours = scene.judged(over_floor(scene.sightings, flight.camera, estimate.w_T_b))
        placed = int((estimate.component == 0).sum())
        rivals += beside_pycolmap(scene, ours_s, ours, placed)
    chain = scene.judged(over_floor(scene.sightings, flight.camera, estimate.chain_w_T_b))
    count = len(flight.landmarks)
    return [
        *told_of("ours", ours, count),
        *told_of("chain of homographies", chain, count),
        told("ours: keyframes placed", placed, "", f"of {len(flight.frames)}"),
        told("ours: time, mosaic included", ours_s, "s", f"{len(flight.frames)} keyframes"),
        told("chain of homographies: time, without a mosaic", estimate.timing_s["track"], "s"),
        *rivals,
    ]


def beside_stitcher(scene: Scene, ours_s: float) -> list[Metric]:
    """OpenCV's stitcher for scans."""
    seconds, canvas_H, status = stitched(scene.pictures)
    on_canvas = [
        carried(canvas_H[s.keyframe], s.pixel) if s.keyframe in canvas_H else np.full(2, np.nan)
        for s in scene.sightings
    ]
    name = "cv2.Stitcher (SCANS)"
    return [
        told(f"{name}: time, mosaic included", seconds, "s", status),
        at_most("our time over cv2.Stitcher's", ours_s / seconds, "x", 1.0),
        *told_of(name, scene.judged(np.array(on_canvas)), len(scene.flight.landmarks)),
    ]


def beside_pycolmap(scene: Scene, ours_s: float, ours: Verdict, placed: int) -> list[Metric]:
    """Structure from motion with the known camera; it draws no mosaic."""
    name = "pycolmap"
    try:
        made = mapped_apart(scene.pictures, scene.camera, LIMIT_S)
    except Skipped as skipped:
        return [told(f"{name}: keyframes placed", float("nan"), "", str(skipped))]
    if made is None:
        late = f"no answer within {LIMIT_S:.0f} s"
        return [told(f"{name}: keyframes placed", 0, "", late)]
    verdict = judge(scene.flight, nearest_to_rays(scene, made.c_T_w))
    theirs = f"{len(made.c_T_w)} placed in the largest of its models ({made.models}), intrinsics given"
    return [
        told(f"{name}: keyframes placed", len(made.c_T_w), "", theirs),
        at_least("our keyframes placed over pycolmap's", placed / max(len(made.c_T_w), 1), "x", 1.0),
        told(f"{name}: time, without a mosaic, CPU", made.seconds, "s"),
        at_most("our time, mosaic included, over pycolmap's", ours_s / made.seconds, "x", 1.0),
        *told_of(name, verdict, len(scene.flight.landmarks)),
        at_most("our RMS of landmark places over pycolmap's", ours.rms_m / verdict.rms_m, "x", 1.0),
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


def told_of(name: str, verdict: Verdict, landmarks: int) -> list[Metric]:
    """The figures of one map."""
    ours = name == "ours"
    in_place, largest = f"{name}: landmarks in their place, of {landmarks}", f"{name}: largest landmark error"
    return [
        at_least(in_place, verdict.in_place, "", landmarks) if ours else told(in_place, verdict.in_place, ""),
        told(f"{name}: RMS of landmark places after a similarity", verdict.rms_m, "m"),
        told(largest, verdict.largest_percent, "%", "of a named distance, after a similarity"),
    ]


def keyframes_of(flight: Flight) -> Flight:
    """The flight with nothing but the pictures that the demo keeps as keyframes."""
    assert flight.frames is not None
    frames, index = flight.frames, optimize(flight).frame_index
    images = [frames.load(int(k)) for k in index]
    names = tuple(frames.names[k] for k in index)
    return replace(
        flight, frames=Frames(frames.stamps_s[index], names, images.__getitem__), all_keyframes=True
    )


def landmarks_seen(landmarks: dict[str, Array], camera: Camera, w_T_b: Array) -> list[Sighting]:
    """Where the true camera sees each landmark."""
    found = []
    for name, w_p in landmarks.items():
        pixel, seen = seen_at(camera, w_T_b, w_p)
        found += [Sighting(name, int(k), pixel[k : k + 1]) for k in np.flatnonzero(seen)]
    return found


def over_floor(sightings: list[Sighting], camera: Camera, w_T_b: Array) -> Array:
    """(m, 2) where a map's poses put each sighting on the floor."""
    return np.array([camera.floor_points(w_T_b[s.keyframe], s.pixel)[0] for s in sightings])


def carried(H: Array, pixel: Array) -> Array:
    """(2,) a pixel on the canvas."""
    u, v, w = H @ np.append(pixel[0], 1.0)
    return np.array([u / w, v / w])


def judge(flight: Flight, mean: Array) -> Verdict:
    """Landmarks at (n, 3) places of a map, NaN where unknown, against the truth."""
    names = list(flight.landmarks)
    true = np.array(list(flight.landmarks.values()))
    known = np.isfinite(mean).all(axis=1)
    if known.sum() < 3:
        return Verdict(0, float("nan"), float("nan"))
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
        int((nearest == np.arange(len(names))).sum()),
        float(np.sqrt(np.mean(off**2))),
        float(np.nanmax(errors)),
    )


def stitched(pictures: Path) -> tuple[float, dict[int, Array], str]:
    """OpenCV's stitcher for scans: seconds, pixels to canvas by keyframe, what became of it."""
    found = run_apart(_ME, pictures, limit_s=LIMIT_S)
    if found is None:
        return LIMIT_S, {}, f"no answer within {LIMIT_S:.0f} s"
    canvas_H = {int(k): np.array(H) for k, H in found["canvas_H"].items()}
    return found["seconds"], canvas_H, found["status"]


def main(pictures: Path) -> None:
    """The process of the stitcher."""
    images = [cv2.imread(str(path)) for path in sorted(pictures.iterdir())]
    cv2.setRNGSeed(0)
    stitcher = cv2.Stitcher.create(cv2.Stitcher_SCANS)
    began = time.perf_counter()
    status = stitcher.estimateTransform(images)
    canvas_H, said = {}, f"gave up with status {status}"
    if status == cv2.Stitcher_OK:
        used = np.ravel(stitcher.component()).astype(int)
        stitcher.composePanorama()
        scale = np.diag([stitcher.workScale(), stitcher.workScale(), 1.0])
        canvas_H = {
            int(k): (np.asarray(camera.R, dtype=float) @ scale).tolist()
            for k, camera in zip(used, stitcher.cameras(), strict=True)
        }
        said = f"{len(used)} of {len(images)} keyframes used"
    print(json.dumps({"seconds": time.perf_counter() - began, "canvas_H": canvas_H, "status": said}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
