"""Linear recursion of the first order: low-pass filters, and noise that is correlated in time."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def recursion(inputs: Array, keep: float) -> Array:
    """Return y with y_k = keep y_(k-1) + x_k, from y_0 = x_0 on, for ``inputs`` x (n,) or (n, columns).

    It is ``scipy.signal.lfilter``, which takes half a second to import.
    """
    share = float(keep)
    columns = np.atleast_2d(inputs.T).tolist()
    outputs = [list(accumulate(column, lambda y, x: share * y + x)) for column in columns]
    return np.array(outputs, dtype=float).T.reshape(inputs.shape)
