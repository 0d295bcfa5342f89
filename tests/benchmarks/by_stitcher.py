"""A mosaic by OpenCV's stitcher for scans: every picture against every other.

``python -m tests.benchmarks.by_stitcher PICTURES`` stitches a folder; prints seconds, what became of it, and
where each picture used lies on the canvas as JSON.
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
    """What came of some pictures."""

    seconds: float
    canvas_H: dict[int, Array]
    """(3, 3) pixels to canvas, by number of the picture, of those used."""
    status: str


def stitched_apart(pictures: Path, limit_s: float) -> Stitched:
    """Stitch a folder in a process of its own; where it takes too long, no picture is used."""
    found = run_apart("tests.benchmarks.by_stitcher", pictures, limit_s=limit_s)
    if found is None:
        return Stitched(limit_s, {}, f"no answer within {limit_s:.0f} s")
    canvas_H = {int(k): np.array(H) for k, H in found["canvas_H"].items()}
    return Stitched(found["seconds"], canvas_H, found["status"])


def main(pictures: Path) -> None:
    """The process of its own."""
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
