"""Brightness of the same pieces of the floor in two pictures, seen through different places of the lens."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.data_quality.pictures.overlaid import Image, Overlaid

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CELL_SHARE = 1 / 15
"""Cell size as a share of the picture's width: averaging over a cell suppresses the floor's detail."""
DARKEST, BRIGHTEST = 12.0, 240.0
CELL_STEPS = (1, 4)
"""Distances in pictures between those whose cells are compared: near ones overlap most, far ones show a piece
through another place of the lens."""
MOST_PAIRS = 1000
"""Greatest number of pairs of a flight, evenly spaced. The lens does not change over a flight."""


@dataclass(frozen=True)
class Cells:
    """The m pieces of the floor (cells) that two pictures show, each through its own place of the lens."""

    earlier: Ints
    """(m,) index of picture i."""
    later: Ints
    """(m,) index of picture j."""
    pixel_i: Array
    """(m, 2) centre in picture i, undistorted pixels."""
    pixel_j: Array
    """(m, 2) centre in picture j, undistorted pixels."""
    ratio: Array
    """(m,) logarithm of the brightness in i over that in j, with both pictures at one overall level."""

    @property
    def runs(self) -> list[slice]:
        """Slices of the cells of each pair of pictures, which are adjacent."""
        index = np.column_stack([self.earlier, self.later])
        begins = np.flatnonzero(np.any(np.diff(index, axis=0, prepend=-1) != 0, axis=1)).tolist()
        return [slice(begin, end) for begin, end in pairwise([*begins, len(index)])]

    @staticmethod
    def of(found: Iterable[tuple[int, int, Array]]) -> Cells:
        """Return the cells of pairs of pictures, given as (i, j, result of ``compared``)."""
        pairs = list(found)
        table = np.concatenate([np.zeros((0, 5)), *(rows for _, _, rows in pairs)])
        index = np.array([(i, j) for i, j, _ in pairs], dtype=np.int64).reshape(-1, 2)
        index = np.repeat(index, [len(rows) for _, _, rows in pairs], axis=0)
        return Cells(index[:, 0], index[:, 1], table[:, :2], table[:, 2:4], table[:, 4])


def compared(small_i: Image, laid: Overlaid) -> Array:
    """Return (m, 5) rows of cells that both pictures show whole: pixel in i, pixel in j, and the logarithm of
    the brightness ratio."""
    side = CELL_SHARE * small_i.shape[1]
    size = tuple(round(n / side) for n in small_i.shape[::-1])

    def mean(x: NDArray[Any]) -> Array:
        return np.asarray(cv2.resize(x.astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float64)

    own, other = mean(small_i), mean(laid.other)
    whole = mean(laid.seen) > 0.999
    for level in (own, other):
        whole &= (level > DARKEST) & (level < BRIGHTEST)
    ratio = np.log(own[whole] / other[whole])
    return np.column_stack([mean(laid.is_px)[whole], mean(laid.was_px)[whole], ratio])


def radius2(camera: Camera, pixel: Array) -> Array:
    """Return (n,) the squared distance of pixels (n, 2) from the centre, in squared half diagonals."""
    half = np.hypot(*camera.size_px) / 2
    return np.asarray(((pixel - camera.center_px) ** 2).sum(axis=1) / half**2)
