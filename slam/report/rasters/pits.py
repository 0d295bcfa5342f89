"""Pits in a measured surface that are deeper than wide, which wrong matches make more often than ground does.

All their walls would stand steeper than 45°, which loose ground does not. A closing of the heights (Serra
1982, chapter 10) fills the pits that are narrower than its square, and low strips at the edge as well.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.surface import Surface
from slam.report.floor_scatter import SURE

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_USUAL_PERCENT = 90
"""Percentile of the standard deviations: that of the less certain heights."""
_STEP = np.sqrt(2.0)
"""Ratio of one depth to the next: a pit is found at 0.7 of its depth at least."""
_CELLS = 11
"""Cells across the square of a closing: larger squares count in larger cells, so that all take as long."""


def doubted_pits(surface: Surface) -> Mask:
    """Return which measured cells lie below the floor in a pit that is deeper than wide."""
    measured = surface.measured
    found: Mask = np.zeros(measured.shape, bool)
    std = surface.std_m[measured]
    std = std[np.isfinite(std)]
    if len(std) == 0:
        return found
    # What stands on the floor has gaps between, which are deeper than wide and true.
    below = np.minimum(surface.height_m, 0.0).astype(np.float32)
    known = measured | surface.on_floor
    # Both the pit and its rim, the highest of many cells, are off by noise.
    depth_m = max(2 * SURE * float(np.percentile(std, _USUAL_PERCENT)), 2 * surface.cell_m)
    while depth_m <= -below[measured].min():
        found |= measured & (_closed(below, known, depth_m / surface.cell_m) - below > depth_m)
        depth_m *= _STEP
    return np.asarray(found, bool)


def lowest_place(surface: Surface, where: Mask) -> tuple[float, float, float] | None:
    """Return x, y and height of the lowest of some cells; None without any."""
    if not where.any():
        return None
    r, c = np.unravel_index(np.argmin(np.where(where, surface.height_m, np.inf)), where.shape)
    return (
        surface.west_m + (float(c) + 0.5) * surface.cell_m,
        surface.north_m - (float(r) + 0.5) * surface.cell_m,
        float(surface.height_m[r, c]),
    )


def _closed(height_m: Float32, known: Mask, width_cells: float) -> Float32:
    """Return the heights with pits filled that are narrower than a square of ``width_cells``."""
    block = max(1, int(width_cells / _CELLS))
    rows, cols = (-(-n // block) for n in height_m.shape)
    padded = np.full((rows * block, cols * block), -np.inf, np.float32)
    padded[: height_m.shape[0], : height_m.shape[1]] = np.where(known, height_m, -np.inf)
    coarse = padded.reshape(rows, block, cols, block).max(axis=(1, 3))
    side = max(3, round(width_cells / block) | 1)
    square = np.ones((side, side), np.uint8)
    higher = np.asarray(cv2.dilate(coarse, square))
    closed = np.asarray(cv2.erode(np.where(np.isfinite(higher), higher, np.inf).astype(np.float32), square))
    closed = np.where(np.isfinite(closed), closed, -np.inf)
    fine = np.repeat(np.repeat(closed, block, axis=0), block, axis=1)
    return np.asarray(fine[: height_m.shape[0], : height_m.shape[1]], np.float32)
