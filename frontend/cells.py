"""Cells of a picture: whether features or matches lie all over it or in one place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GRID = (8, 6)
"""Cells across and down a picture."""
COUNT = GRID[0] * GRID[1]


def cells(pixel: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.int64]:
    """(n,) number of the cell, row by row, in which each pixel (n, 2) of a picture (width, height) lies."""
    place = np.clip(pixel / size_px * GRID, 0, np.array(GRID) - 1).astype(np.int64)
    return place[:, 1] * GRID[0] + place[:, 0]
