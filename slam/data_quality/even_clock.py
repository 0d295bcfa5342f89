"""Offsets of stamps from the even clock by which an instrument samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
SLOW = 3.0
"""Least period in scatters. Stamps of a faster stream overtake one another, and their offsets in sorted order
are smaller than the jitter."""


@dataclass(frozen=True)
class StampOffsets:
    """Stamps of one stream beside its even clock."""

    period_s: float
    off_s: Array
    """(readings,) stamp minus even clock; NaN without an even clock."""

    @property
    def scatter_s(self) -> float:
        """Standard deviation of ``off_s``."""
        return float(np.nanstd(self.off_s))


def stamp_offsets(times_s: Array) -> StampOffsets | None:
    """Return the offsets of stamps (n,), each segment between long gaps with a clock of its own; None without
    an even clock."""
    period_s = float(np.ptp(times_s)) / max(len(times_s) - 1, 1)
    edges = np.flatnonzero(np.diff(times_s) > LONG_GAP * period_s) + 1
    off_s = np.concatenate([_off_s(part) for part in np.split(times_s, edges)])
    return StampOffsets(period_s, off_s) if np.isfinite(off_s).any() else None


def jitter_of(streams: Sequence[StampOffsets]) -> tuple[float, float]:
    """Return the jitter's standard deviation and its standard error, from streams with long periods, or from
    the slowest stream."""
    slow = [s for s in streams if s.period_s > SLOW * s.scatter_s]
    slow = slow or [max(streams, key=lambda s: s.period_s)]
    square = np.concatenate([s.off_s[np.isfinite(s.off_s)] for s in slow]) ** 2
    sigma = float(np.sqrt(square.mean()))
    return sigma, float(square.std() / np.sqrt(len(square))) / (2.0 * sigma)


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
