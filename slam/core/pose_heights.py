"""How well the heights of poses are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def up_stds(w_T_b: Array, covariances: Array) -> Array:
    """Return the standard deviation (n,) of the height of poses (n, 4, 4) with covariances (n, 6, 6); NaN
    where it is not known."""
    variance = np.einsum("ni,nij,nj->n", w_T_b[:, 2, :3], covariances[:, 3:, 3:], w_T_b[:, 2, :3])
    return np.asarray(np.sqrt(np.where(variance >= 0, variance, np.nan)))
