"""Quantiles of a weighted sum of chi-squares, the distribution of a mean of dependent squared errors.

Source: Davies 1973, Numerical inversion of a characteristic function, Biometrika 60, equations 3 and 5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]

_STDS = 30.0
"""Largest sum that counts, in standard deviations above the mean; larger ones have a probability below 1e-8.
With steps of finite width the probabilities repeat beyond it, and are off by as much."""
_TERMS = 4096
"""Steps, after which the terms of three equal weights are below 1e-8. Where one weight is nearly all, the
lower quantile is off by 0.001 of the mean."""
_LEAST = 1e-10
"""Size of the characteristic function below which terms are left out."""


def weighted_chi_square_interval(share: float, weights: Array, dof: Array) -> tuple[float, float]:
    """Return the values between which a sum of independent chi-squares times ``weights`` (m,) lies with the
    probability ``share``, and below and above which it lies equally often.

    ``dof`` (m,) are their degrees of freedom, at least three together, and need not be whole numbers.
    """
    mean, std = float(weights @ dof), float(np.sqrt(2 * weights**2 @ dof))
    largest = mean + _STDS * std
    half = np.arange(_TERMS) + 0.5
    log_size = -0.25 * np.log1p((4 * np.pi / largest * half[:, None] * weights) ** 2) @ dof
    half = half[log_size > np.log(_LEAST)]
    t = 2 * np.pi / largest * half
    characteristic = np.exp(-0.5 * np.log(1 - 2j * t[:, None] * weights) @ dof) / (np.pi * half)

    def probability_below(value: float) -> float:
        return float(0.5 - np.sum((characteristic * np.exp(-1j * t * value)).imag))

    def quantile(probability: float) -> float:
        return float(brentq(lambda value: probability_below(value) - probability, 0.0, largest))

    return quantile(0.5 * (1 - share)), quantile(0.5 * (1 + share))
