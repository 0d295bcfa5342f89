"""Statistics that a few values far off do not move."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

NORMAL = 1.4826
"""Standard deviation of normal draws over the median of their sizes."""


def median(values: NDArray[np.float64]) -> float:
    """Of (n,) finite ones, n > 0; as numpy's, which takes longer to look for NaN than to find it."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    below, above = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((below + above) / 2)


def robust_std(values: NDArray[Any]) -> float:
    """Standard deviation of what most of (n,) values about 0 do; NaN where one is."""
    return NORMAL * float(np.median(np.abs(values)))
