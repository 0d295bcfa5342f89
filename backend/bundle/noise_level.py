"""Noise levels from residuals of a fit that follows its own measurements.

``absorbed`` is the number of residuals that it follows, the trace of the hat matrix
(`backend.bundle.position_redundancy`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.measurements import Position

Array = NDArray[np.float64]

NOMINAL_COUNT = 20
"""Weight of a nominal noise level, as a number of residuals."""


def redundancy_factor(count: int, absorbed: Array) -> float:
    """Return the factor on the standard deviation of ``count`` residuals for what the fit absorbs."""
    return float(np.sqrt(count / _left(count, absorbed)))


def least_std(before: float, count: int, absorbed: Array) -> float:
    """Return the least standard deviation that ``count`` residuals can show, of a fit with noise ``before``.

    A value differs from what all others predict for it by its own variance and by P, that of the prediction.
    With the mean leverage h the fit has P = before^2 h / (1 - h). The variance of ``count`` such differences
    is known to sqrt(2 / count) of itself, so a variance below P sqrt(2 / count) cannot be told from zero.
    """
    left = _left(count, absorbed)
    predicted = before**2 * (count - left) / left
    return float(np.sqrt(predicted * np.sqrt(2.0 / count)))


def pooled(nominal: float, found: float, count: int) -> float:
    """Pool a nominal standard deviation with that of ``count`` residuals, ``found``.

    If the latter is smaller, the nominal one counts as `NOMINAL_COUNT` more residuals, since a few residuals
    may be small by chance. One degree of freedom is spent on the scale (ranges) or the tilt (attitudes).
    """
    squares, dof = count * found**2, count - 1
    return float(np.sqrt(max(squares / dof, (NOMINAL_COUNT * nominal**2 + squares) / (NOMINAL_COUNT + dof))))


def _left(count: int, absorbed: Array) -> float:
    return max(count - float(absorbed.sum()), 1.0)


def over_typical(stated: Sequence[float] | Array) -> Array:
    """Return the stated deviations (n,) of readings over their median: a reading at the edge of a recording,
    or beside a gap, may be several times as uncertain as the others. One that states none counts as typical.
    """
    std = np.asarray(stated, dtype=float)
    known = np.isfinite(std) & (std > 0)
    typical = np.median(std[known]) if known.any() else 1.0
    return np.where(known, std / typical, 1.0)


def positions_over_typical(positions: Sequence[Position]) -> Array:
    """Return the stated deviations (n, 3) of positions over their medians along each axis."""
    stated = np.array([p.std_m for p in positions]).reshape(-1, 3)
    return np.column_stack([over_typical(axis) for axis in stated.T])
