"""Posterior of a delay between two clocks, from the cost of each delay of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FINE = 20
"""Steps of the posterior's grid in one of the cost's."""


def grid_posterior(tried_s: Array, cost: Array) -> tuple[Array, Array]:
    """Return a finer grid of delays and their probabilities.

    ``cost`` (g,) is the log-likelihood, times -2, at the evenly spaced delays ``tried_s`` (g,).
    """
    from scipy.interpolate import CubicSpline  # a long import, for this alone

    delays_s = np.linspace(tried_s[0], tried_s[-1], (len(tried_s) - 1) * _FINE + 1)
    fine = CubicSpline(tried_s, cost)(delays_s)
    weight = np.exp(-0.5 * (fine - fine.min()))
    return delays_s, weight / weight.sum()
