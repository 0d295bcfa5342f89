"""Means of readings over successive windows of time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def window_means(stamps_s: Array, values: Array, begin_s: float, window_s: float) -> tuple[Array, Array]:
    """Return the numbers (m,) of the windows from ``begin_s`` on that hold readings, and their means (m, c).

    The readings (n, c) may be before the first window too: such windows have negative numbers.
    """
    number, window = np.unique(np.floor((stamps_s - begin_s) / window_s), return_inverse=True)
    count = np.bincount(window)
    return number, np.column_stack([np.bincount(window, column) / count for column in values.T])
