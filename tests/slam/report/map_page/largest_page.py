"""The largest page that a flight can make: as many pixels, cells, links and points as are ever drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from backend.measurements import RelativePose
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.floor_points import FloorPoints
from slam.io.geotiff import Grid, write_bands
from slam.report.facts import gather
from slam.report.map_page.features import MOST_LINKS, MOST_POINTS
from slam.report.map_page.rasters import MOST_CELLS, MOST_PIXELS
from slam.report.map_page.write import write_map_page
from tests.slam.made_estimate import REJECTION, made_estimate

_SIDE_M = 5.0
_WEST_M, _NORTH_M = -0.25, 4.75


def largest_page(folder: Path) -> Path:
    """Write it into an empty folder, without pictures of keyframes."""
    side = int(MOST_PIXELS**0.5)
    rng = np.random.default_rng(0)
    for name in ("mosaic", "mosaic_chain"):
        # Ground of stones and of grains: noise of single pixels alone would be twice as large as any floor.
        stones = cv2.resize(rng.integers(0, 160, (side // 12, side // 12, 3), np.uint8), (side, side))
        rgb = stones + rng.integers(0, 60, (side, side, 3), np.uint8)
        rgba = np.dstack([rgb, np.full((side, side), 255, np.uint8)])
        cv2.imwrite(str(folder / f"{name}.png"), rgba, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        gsd_m = _SIDE_M / side
        (folder / f"{name}.pgw").write_text(
            f"{gsd_m}\n0\n0\n{-gsd_m}\n{_WEST_M + gsd_m / 2}\n{_NORTH_M - gsd_m / 2}\n"
        )
    cells = int(MOST_CELLS**0.5)
    grid = Grid(_WEST_M, _NORTH_M, _SIDE_M / cells, cells, cells)
    values = rng.uniform(0, 0.2, (cells, cells)).astype(np.float32)
    write_bands(folder / "elevation.tif", grid, {"height": values})
    write_bands(folder / "mosaic_quality.tif", grid, {"pictures": values, "position": values, "seam": values})
    estimate = _estimate(rng)
    page = write_map_page(folder, estimate, None, gather(estimate, None), "ok")
    assert page is not None
    return page


def _estimate(rng: np.random.Generator) -> Estimate:
    estimate = made_estimate(MOST_LINKS)
    far = rng.integers(0, MOST_LINKS, (2, MOST_LINKS))
    loops = [RelativePose(i, j, np.eye(4), np.eye(6), "loop") for i, j in np.sort(far, axis=0).T.tolist()]
    rejected = tuple(LoopVerdict(e.i, e.j, REJECTION) for e in reversed(loops))
    b_p_m = np.column_stack([rng.uniform(-0.5, 0.5, (2 * MOST_POINTS, 2)), np.full(2 * MOST_POINTS, -0.8)])
    points = FloorPoints(
        rng.integers(0, MOST_LINKS, 2 * MOST_POINTS),
        b_p_m,
        rng.integers(2, 20, 2 * MOST_POINTS),
        np.full((2 * MOST_POINTS, 3), 0.01),
    )
    return replace(
        estimate, relative_poses=(*estimate.relative_poses, *loops), loops=rejected, floor_points=points
    )
