"""Vectors of three numbers as tuples, which records of results hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return a vector (3,) as a tuple. Raises ``ValueError`` for another length."""
    x, y, z = vector.tolist()
    return x, y, z
