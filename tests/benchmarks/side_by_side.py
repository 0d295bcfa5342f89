"""The demo's keyframes stitched by OpenCV, by the chain of homographies, and by us, in one run.

Every map is judged in the same way: where it has the landmarks, after the similarity of least squares.
OpenCV's stitcher runs in a process of its own with a time limit: it compares every picture with every other.
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
from tests.benchmarks.metric import Metric, at_least, at_most, told

Array = NDArray[np.float64]

_ME = "tests.benchmarks.side_by_side"
STITCHER_LIMIT_S = 420.0


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


def measure() -> list[Metric]:
    """Time, topology and landmark error of the three."""
    whole = simulate("figure_eight", 0)
    flight = keyframes_of(whole)
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
        stitcher_s, canvas_H, status = stitched(pictures)
    truth = associate(estimate, flight).w_T_b
    assert truth is not None
    sightings = landmarks_seen(flight.landmarks, flight.camera, truth)
    ways = {
        "ours": judge(flight, sightings, over_floor(sightings, flight.camera, estimate.w_T_b)),
        "chain of homographies": judge(
            flight, sightings, over_floor(sightings, flight.camera, estimate.chain_w_T_b)
        ),
    }
    metrics = []
    for name, verdict in ways.items():
        metrics += told_of(name, verdict, len(flight.landmarks))
    metrics += [
        told("ours: time, mosaic included", ours_s, "s", f"{len(flight.frames)} keyframes"),
        told("chain of homographies: time, without a mosaic", estimate.timing_s["track"], "s"),
        told("cv2.Stitcher (SCANS): time, mosaic included", stitcher_s, "s", status),
        at_most("our time over cv2.Stitcher's", ours_s / stitcher_s, "x", 1.0),
    ]
    on_canvas = [
        carried(canvas_H[s.keyframe], s.pixel) if s.keyframe in canvas_H else np.full(2, np.nan)
        for s in sightings
    ]
    return metrics + told_of(
        "cv2.Stitcher (SCANS)", judge(flight, sightings, np.array(on_canvas)), len(flight.landmarks)
    )


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


def judge(flight: Flight, sightings: list[Sighting], places: Array) -> Verdict:
    """Landmarks at the mean of their (m, 2) places, against the truth."""
    names = list(flight.landmarks)
    mean = np.full((len(names), 3), np.nan)
    for row, name in enumerate(names):
        mine = [p for s, p in zip(sightings, places, strict=True) if s.name == name and np.isfinite(p).all()]
        if mine:
            mean[row] = np.append(np.mean(mine, axis=0), 0.0)
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
    found = run_apart(_ME, pictures, limit_s=STITCHER_LIMIT_S)
    if found is None:
        return STITCHER_LIMIT_S, {}, f"no answer within {STITCHER_LIMIT_S:.0f} s"
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
