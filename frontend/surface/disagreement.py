"""Ground on which no two pictures agree: water and crowns that move, or a surface without texture.

Single squares fail by chance. A group of neighbours stands out if flat maps seldom have one as large. Of the
connected sets of n squares there are at most 4.0626^n for each place (Jensen 2003, Counting polyominoes: the
parallel implementation). If squares fail independently with probability p, a map of N squares is therefore
expected to have at most N (4.0626 p)^n sets of n failed ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import MosaicGrid
from frontend.surface.misregistration import SQUARE_PX, Misregistration
from frontend.surface.relief import FALSE_SHARE

_SETS = 4.0626
"""Growth of the number of connected sets with each square."""


@dataclass(frozen=True)
class Disagreement:
    """Ground of a mosaic on which the two pictures that see it best do not agree."""

    share: float = 0.0
    """Share of the ground that two pictures show, in groups of squares that chance does not make."""
    at_m: tuple[float, float] | None = None
    """Middle of the largest group, x and y; None without any."""


def disagreement(measured: Misregistration, grid: MosaicGrid) -> Disagreement:
    """Return where the pictures of a mosaic do not agree."""
    groups = groups_beyond_chance(measured)
    if not groups:
        return Disagreement()
    row, col = groups[0][np.argmin(np.linalg.norm(groups[0] - groups[0].mean(axis=0), axis=1))] + 0.5
    side_m = SQUARE_PX * grid.gsd_m
    at_m = grid.west_m + float(col) * side_m, grid.north_m - float(row) * side_m
    return Disagreement(sum(map(len, groups)) / len(measured.square), at_m)


def groups_beyond_chance(measured: Misregistration) -> list[NDArray[np.int64]]:
    """Return rows and columns (n, 2) of each group of squares without agreement, the largest first.

    The probability of chance is that of the squares outside of the group.
    """
    failed = np.zeros(measured.shape, np.uint8)
    failed[tuple(measured.square[~measured.found].T)] = 1
    count, label = cv2.connectedComponents(failed, connectivity=4)
    groups = sorted((np.argwhere(label == k) for k in range(1, count)), key=len, reverse=True)
    kept, others = list[NDArray[np.int64]](), int(failed.sum())
    for group in groups:
        others -= len(group)
        # One more of either kind, so that a map without any other is not taken to have none by law.
        chance = (others + 1) / (len(measured.square) - len(group) + 2)
        if len(measured.square) * (_SETS * chance) ** len(group) > FALSE_SHARE:
            break
        kept.append(group)
    return kept
