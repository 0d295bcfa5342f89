"""Pairs of fixes, drawn without a list of all pairs, whose memory would grow with the square of the fixes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]


def some_pairs(n: int, most: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Return all pairs i < j of n items by i and then j, or ``most`` different ones at random."""
    first = np.arange(max(n - 1, 0))
    begin = first * n - first * (first + 1) // 2  # number of the pair (i, i + 1)
    total = n * (n - 1) // 2
    chosen = np.arange(total) if total <= most else rng.choice(total, most, replace=False)
    i = np.searchsorted(begin, chosen, side="right") - 1
    return i, chosen - begin[i] + i + 1
