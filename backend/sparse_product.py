"""Product of a transition matrix, most of which is zero, with a matrix: a numba kernel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.compilation import discard_stale, inlined_kernel

Array = NDArray[np.float64]

discard_stale([Path(__file__)])


@inlined_kernel
def multiply_sparse(F: Array, right: Array, rows: int, columns: int, product: Array) -> None:
    """Write the first rows and columns of ``F right`` into ``product``. Zeros of F cost nothing."""
    for i in range(rows):
        for j in range(columns):
            product[i, j] = 0.0
        for k in range(F.shape[1]):
            f = F[i, k]
            if f != 0.0:
                for j in range(columns):
                    product[i, j] += f * right[k, j]
