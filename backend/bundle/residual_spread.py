"""Standard deviations of residuals that have outliers, or are correlated in time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_quantile, chi_square_tail
from backend.robust import huber_limit

Array = NDArray[np.float64]


def huber_std(x: Array, k: float) -> float:
    """Return the standard deviation per coordinate of residuals (m, d): Huber's proposal 2, cut at k.

    The median would use the core alone, and the covariance of estimates with Huber's loss would be too small.
    Source: Huber and Ronchetti 2009, section 6.4; the expectation is that of a chi-square variable.
    """
    d = x.shape[1]
    distance = np.linalg.norm(x, axis=1)
    sigma = float(np.median(distance)) / float(np.sqrt(chi_square_quantile(0.5, d)))
    expected = d * (1.0 - chi_square_tail(k**2, d + 2)) + k**2 * chi_square_tail(k**2, d)
    for _ in range(30):
        if sigma <= 0:
            break
        sigma *= float(np.sqrt(np.mean(np.minimum(distance / sigma, k) ** 2) / expected))
    return sigma


def robust_autocorrelated_std(x: Array) -> float:
    """Return `autocorrelated_std` of residuals (n, d) whose outliers are cut where Huber's loss cuts them:
    one wrong reading spoils no other."""
    limit = huber_limit(x.shape[1])
    std = huber_std(x, limit)
    if std <= 0:
        return autocorrelated_std(x)
    distance = np.linalg.norm(x, axis=1, keepdims=True) / std
    cut = x / np.maximum(distance / limit, 1.0)
    plain = float(np.sqrt(np.mean(cut**2)))
    return std * autocorrelated_std(cut) / plain if plain > 0 else std


def autocorrelated_std(x: Array) -> float:
    """Return the standard deviation to use for each value of a correlated series (n, d) as if independent.

    An error that is constant over L keyframes is worth one measurement, not L: the variance is multiplied by
    the integrated autocorrelation. Source: Sokal 1997, section 3 (self-consistent window).
    """
    x = np.asarray(x, dtype=float)
    n = len(x)
    variance = float(np.mean(x**2))
    if variance <= 0 or n < 4:
        return float(np.sqrt(variance))
    total, lag = 1.0, 0
    for lag in range(1, n // 2):
        total += 2 * float(np.mean(np.sum(x[lag:] * x[:-lag], axis=1))) / (x.shape[1] * variance)
        if lag > 5 * total:
            break
    # Independent values are slightly correlated by chance.
    if total - 1 < 2 * np.sqrt(4 * lag / x.size):
        return float(np.sqrt(variance))
    return float(np.sqrt(variance * total))
