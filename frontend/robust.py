"""Robust statistics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute value."""


def median(values: NDArray[np.float64]) -> float:
    """Return the median of (n,) finite values, n > 0; faster than numpy's, which checks for NaN."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    below, above = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((below + above) / 2)


def robust_std(values: NDArray[Any]) -> float:
    """Return the robust standard deviation (MAD about 0) of (n,) values; NaN where one is NaN."""
    return NORMAL * float(np.median(np.abs(values)))
