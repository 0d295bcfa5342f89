"""Grid cells of a picture, to measure how features or matches are distributed over it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

GRID = (8, 6)
"""Cells across and down a picture."""
COUNT = GRID[0] * GRID[1]


def cells(pixel: NDArray[np.float64], size_px: tuple[int, int], grid: tuple[int, int] = GRID) -> Ints:
    """Return the cell number (n,), row by row, of each pixel (n, 2) of a picture (width, height)."""
    (across, down), (w, h) = grid, size_px
    column = np.clip(pixel[:, 0] * across / w, 0, across - 1).astype(np.int64)
    row = np.clip(pixel[:, 1] * down / h, 0, down - 1).astype(np.int64)
    return row * across + column


def occupied(cell: Ints) -> NDArray[np.bool_]:
    """Return (COUNT,) whether each cell of ``GRID`` occurs in ``cell``."""
    return np.bincount(cell, minlength=COUNT) > 0


def place_in_run(group: Ints) -> Ints:
    """Return the position of each entry in its run of equal entries: 0, 1, 2, ..."""
    begin = np.flatnonzero(np.diff(group, prepend=-1))
    return np.arange(len(group)) - np.repeat(begin, np.diff(begin, append=len(group)))
