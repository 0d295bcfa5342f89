"""Time and memory of mosaics: ten times the pictures, and two thousand of them.

``python -m tests.benchmarks.mosaic`` prints the table; each figure is taken in a process of its own, since a
process never gives back its peak.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.estimate import Estimate
from slam.flight import Flight, Frames
from slam.mosaic import write_mosaic

CAMERA = Camera((1000.0, 1000.0), (599.5, 449.5), (1200, 900))
HEIGHT_M = 30.0


@dataclass(frozen=True)
class MosaicRun:
    """One mosaic."""

    scene: str
    keyframes: int
    used: int
    megapixels: float
    seconds: float
    peak_mb: float
    seam_before: float
    seam_after: float


def poses(scene: str, count: int, seed: int = 0) -> NDArray[np.float64]:
    """``hover`` over one spot; ``lines``: always the same 12; ``area``: the ground grows with the count."""
    rng = np.random.default_rng(seed)
    if scene == "hover":
        xy = rng.normal(0, 0.3, (count, 2))
    elif scene == "lines":
        line = np.arange(count) % 12
        xy = np.column_stack([100 * (np.arange(count) // 12) / (count // 12), 8.0 * line])
    else:
        side = int(np.sqrt(count))
        xy = np.column_stack([12.0 * (np.arange(count) % side), 9.0 * (np.arange(count) // side)])
    w_T_b = np.tile(np.eye(4), (count, 1, 1))
    w_T_b[:, :2, 3] = xy + rng.normal(0, 0.2, (count, 2))
    w_T_b[:, 2, 3] = HEIGHT_M * rng.uniform(0.95, 1.05, count)
    return w_T_b


def run(scene: str, count: int) -> MosaicRun:
    """Render one scene in this process."""
    w_T_b = poses(scene, count)
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (2048, 2048, 3), np.uint8), (0, 0), 2)
    texture = cv2.normalize(texture, None, 40, 200, cv2.NORM_MINMAX)
    gain = rng.uniform(0.8, 1.2, count)

    def load(k: int) -> NDArray[np.uint8]:
        texel_H_floor = np.array([[20.0, 0, 1e5], [0, -20.0, 1e5], [0, 0, 1]])
        texel_H_pixel = texel_H_floor @ CAMERA.floor_H_image(w_T_b[k])
        # The texture repeats: whole periods are taken off, so that the floor has no end.
        texel_H_pixel[:2] -= np.round(texel_H_pixel[:2, 2:] / 2048) * 2048 * texel_H_pixel[2:]
        picture = cv2.warpPerspective(
            texture, texel_H_pixel, CAMERA.size_px, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )  # fmt: skip
        return cv2.convertScaleAbs(picture, alpha=gain[k])

    stamps, names = np.arange(count) * 1.0, tuple(map(str, range(count)))
    estimate = Estimate(
        scene, "ok", 0, stamps, names, np.arange(count), w_T_b, np.full((count, 6, 6), np.nan),
        np.zeros(count, np.int64), CAMERA, 0.0, None, (), (), w_T_b, w_T_b,
    )  # fmt: skip
    flight = Flight(scene, camera=CAMERA, frames=Frames(stamps, names, load))
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        files = write_mosaic(estimate, flight, folder)
    return MosaicRun(
        scene,
        count,
        files.pictures,
        files.width * files.height / 1e6,
        time.perf_counter() - began,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        files.seam_before,
        files.seam_after,
    )


def run_apart(scene: str, count: int) -> MosaicRun:
    """Render one scene in a new process."""
    command = [sys.executable, "-m", "tests.benchmarks.mosaic", scene, str(count)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return MosaicRun(**json.loads(done.stdout))


def main() -> None:
    """Print all figures."""
    print(f"{'scene':8}{'keyframes':>10}{'used':>6}{'Mpx':>7}{'s':>7}{'peak MB':>9}{'seam':>8}{'after':>8}")
    for scene, count in [
        ("hover", 100),
        ("hover", 1000),
        ("lines", 120),
        ("lines", 1200),
        ("area", 200),
        ("area", 2000),
    ]:
        r = run_apart(scene, count)
        print(
            f"{r.scene:8}{r.keyframes:10}{r.used:6}{r.megapixels:7.1f}{r.seconds:7.1f}{r.peak_mb:9.0f}"
            f"{r.seam_before:8.3f}{r.seam_after:8.3f}",
            flush=True,
        )


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(asdict(run(sys.argv[1], int(sys.argv[2])))))
    else:
        main()
