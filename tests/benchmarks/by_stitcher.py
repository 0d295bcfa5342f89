"""Mosaic by OpenCV's stitcher for scans, with exhaustive matching.

``python -m tests.benchmarks.by_stitcher PICTURES`` stitches a folder; it prints the time, the result, and the
place on the canvas of each picture used, as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.apart import run_apart

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stitched:
    """Result of some pictures."""

    seconds: float
    canvas_H: dict[int, Array]
    """Homographies (3, 3) from pixels to canvas, by index, of the pictures used."""
    status: str


def stitched_apart(pictures: Path, limit_s: float) -> Stitched:
    """Stitch a folder in a separate process; after a time-out no picture is used."""
    found = run_apart("tests.benchmarks.by_stitcher", pictures, limit_s=limit_s)
    if found is None:
        return Stitched(limit_s, {}, f"no answer within {limit_s:.0f} s")
    canvas_H = {int(k): np.array(H) for k, H in found["canvas_H"].items()}
    return Stitched(found["seconds"], canvas_H, found["status"])


def main(pictures: Path) -> None:
    """Run the separate process."""
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
