"""Matrices that whiten errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def whitening(covariance: Array) -> Array:
    """Return the lower triangular W with W C W' = 1 for covariances C. (..., d, d) -> (..., d, d).

    It is the inverse of the Cholesky factor. Raises ``numpy.linalg.LinAlgError`` where C is not positive
    definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=float)
