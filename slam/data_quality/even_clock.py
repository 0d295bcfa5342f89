"""Offsets of stamps from the even clock by which an instrument samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_READINGS = 50
LONG_GAP = 10.0
"""Gap in periods that separates two segments with a clock each."""
LEAST_SCATTER_S = 1e-4
"""A smaller scatter moves no reading by its noise."""
BLOCK = 25
MOST_WANDER = 0.6
"""Greatest ratio of the scatter of block means to that of single stamps. Lost readings and a wandering clock
have 1; independent jitter has at most 0.4, even in order of arrival."""


def off_even_clock_s(times_s: Array, period_s: float) -> Array:
    """Return (n,) stamp minus even clock, for each segment between long gaps; NaN without an even clock."""
    edges = np.flatnonzero(np.diff(times_s) > LONG_GAP * period_s) + 1
    return np.concatenate([_off_s(part) for part in np.split(times_s, edges)])


def _off_s(times_s: Array) -> Array:
    """Return (n,) the offsets of stamps without a gap from an even clock; NaN without one."""
    if len(times_s) < FEWEST_READINGS:
        return np.full(len(times_s), np.nan)
    count = np.arange(len(times_s))
    off_s = np.asarray(times_s - np.polyval(np.polyfit(count, times_s, 1), count))
    blocks = off_s[: len(off_s) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    if blocks.std() > MOST_WANDER * off_s.std() and off_s.std() > LEAST_SCATTER_S:
        return np.full(len(times_s), np.nan)
    return off_s
