"""How many floor points on the ground tell one height: neighbours rise and fall together.

The mean of n independent heights of deviation s is known to s / sqrt(n). Where neighbours rise and fall
together it is known no better than that of n / D independent heights; D is their design effect. The ground is
divided into square blocks of several sizes. In each, the sum of the heights z with weights w varies more than
that of independent ones, by the products w_i w_j z_i z_j of its pairs. The size that shows most of it counts:
short waves cancel in large blocks, and small blocks are all on one slope of a long wave.

Source: Kish 1965 (design effect); Flyvbjerg and Petersen 1989 (blocks of growing size); Satterthwaite 1946
(sums of squares of unequal weights).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit
from backend.significance import FALSE_ALARM

Array = NDArray[np.float64]

_LARGEST_BLOCK = 0.5
"""Side of the largest blocks over that of a square as large as the ground: four of them cover it."""
_FEWEST_POINTS = 2.0
"""Points of the smallest blocks, on average: fewer have hardly any pairs."""
_EXTENT_PERCENT = 1.0, 99.0
"""Percentiles of the places between which the ground lies: a wrong point may be anywhere."""
_MOST_SIGMAS = 3.0
"""Standard deviations beyond which one height counts no more."""


def design_effect(xy: Array, z: Array, variance: Array, relief: float) -> float:
    """Return the number of points with heights (t,) at places (t, 2) that tell as much as one; at least 1.

    ``variance`` (t,) is that of the heights by the pictures, and ``relief`` the deviation of the ground.
    """
    if len(z) < 2:
        return 1.0
    weight = 1.0 / (relief**2 + variance)
    limit = _MOST_SIGMAS / np.sqrt(weight)
    weighted = weight * np.clip(z, -limit, limit)
    low, high = np.percentile(xy, _EXTENT_PERCENT, axis=0)
    place = np.clip(xy, low, high) - low
    largest = _LARGEST_BLOCK * float(np.sqrt((high - low).prod()))
    # Each size of blocks has twice the area of the next.
    sizes = int(np.log2(max(_LARGEST_BLOCK**2 * len(z) / _FEWEST_POINTS, 1.0))) + 1 if largest > 0 else 0
    most = 1.0
    for side in largest * 2.0 ** (-0.5 * np.arange(sizes)):
        column, row = (place / side).astype(np.int64).T
        block = column * (row.max() + 1) + row
        pairs = np.sum(np.bincount(block, weighted) ** 2) - np.sum(weighted**2)
        if pairs > _by_chance(np.bincount(block, weight).astype(float), weight, FALSE_ALARM / sizes):
            most = max(most, 1.0 + float(pairs / (relief**2 * np.sum(weight**2))))
    return most


def _by_chance(of_block: Array, weight: Array, probability: float) -> float:
    """Return what the pairs of independent heights exceed with a probability.

    ``of_block``: sums of the ``weight`` (t,) of the points in each block.
    """
    squares = np.sum(of_block**2)
    freedom = float(squares**2 / np.sum(of_block**4))
    std = np.sqrt(2.0 * (squares - np.sum(weight**2)))
    excess = chi_square_limit(probability, freedom) - freedom
    return float(std * excess / np.sqrt(2.0 * freedom))
