"""Time and memory of mosaics: ten times the pictures over the same ground, and over ten times the ground.

Each is rendered again after a few pictures in its middle have moved.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.streams import Frames
from slam.report.rasters.mosaic import write_mosaic
from tests.benchmarks.apart import peak_mb, run_apart
from tests.benchmarks.metric import Metric, at_most, reported

CAMERA = Camera((1000.0, 1000.0), (599.5, 449.5), (1200, 900))
HEIGHT_M = 30.0
MOVED, MOVED_M = 3, 0.05
"""Indices of the moved pictures: neighbours, so that at least one of them is visible."""


@dataclass(frozen=True)
class MosaicRun:
    """Result of one mosaic."""

    scene: str
    keyframes: int
    used: int
    megapixels: float
    seconds: float
    peak_mb: float
    seam_before: float
    seam_after: float
    tiles: int
    again: int
    """Number of tiles rendered after some pictures had moved."""
    again_s: float


SCENES = {
    "hover": (100, 1000, "over one spot"),
    "lines": (120, 1200, "along the same lines"),
    "area": (200, 2000, "over ground that grows with them"),
}
LARGE = "area"
"""Scene whose larger mosaic has limits of memory and time."""


def measure() -> list[Metric]:
    """Return the figures of each scene, with few and with ten times as many pictures."""
    metrics = []
    for scene, (few, many, where) in SCENES.items():
        a, b = (MosaicRun(**run_apart("tests.benchmarks.mosaic", scene, n)) for n in (few, many))
        source = f"{a.peak_mb:.0f} -> {b.peak_mb:.0f} MB, {a.megapixels:.0f} -> {b.megapixels:.0f} Mpx"
        seams = f"{b.seam_before:.3f} -> {b.seam_after:.4f}, rms share of brightness"
        metrics += [
            at_most(
                f"seams after compensation over before, {where}",
                b.seam_after / b.seam_before,
                "x",
                0.5,
                seams,
            ),
            reported(
                f"mosaic memory, {many} over {few} pictures {where}", b.peak_mb / a.peak_mb, "x", source
            ),
            reported(
                f"mosaic time, {many} over {few} pictures {where}",
                b.seconds / a.seconds,
                "x",
                f"{a.seconds:.1f} -> {b.seconds:.1f} s",
            ),
        ]
        if scene == LARGE:
            metrics += [
                at_most(f"memory of a mosaic of {many} pictures", b.peak_mb, "MB", 2000, f"{b.used} used"),
                at_most(
                    f"time of a mosaic of {many} pictures", b.seconds, "s", 90, f"{b.megapixels:.0f} Mpx"
                ),
                reported(
                    f"tiles rendered again after {MOVED} of {many} pictures moved by {MOVED_M:g} m", b.again,
                    "", f"of {b.tiles}, in {b.again_s:.0f} s",
                ),
            ]  # fmt: skip
    return metrics


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
    unknown = np.full((count, 6, 6), np.nan)
    estimate = Estimate(
        name=scene,
        epoch_ns=0,
        stamps_s=stamps,
        frame_names=names,
        frame_index=np.arange(count),
        w_T_b=w_T_b,
        covariances=unknown,
        over_floor_covariances=unknown,
        component=np.zeros(count, np.int64),
        camera=CAMERA,
        floor_z_m=0.0,
        origin=None,
        relative_poses=(),
        loops=(),
        chain_w_T_b=w_T_b,
        odometry_w_T_b=w_T_b,
    )
    flight = Flight(scene, camera=CAMERA, frames=Frames(stamps, names, load))
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        files = write_mosaic(estimate, flight, folder)
        done = time.perf_counter()
        moved = w_T_b.copy()
        moved[count // 2 : count // 2 + MOVED, 0, 3] += MOVED_M
        again = write_mosaic(replace(estimate, w_T_b=moved), flight, folder)
        again_s = time.perf_counter() - done
    return MosaicRun(
        scene, count, files.pictures, files.width * files.height / 1e6, done - began, peak_mb(),
        files.seam_before, files.seam_after, again.tiles, again.tiles - again.kept, again_s,
    )  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(asdict(run(sys.argv[1], int(sys.argv[2])))))
