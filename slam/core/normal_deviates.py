"""Normal deviates of other statistics: standard deviations of one normal quantity that are as improbable."""

from __future__ import annotations

import numpy as np
from scipy.special import betaln, ndtri_exp
from scipy.stats import chi2, f, norm


def deviate(chi_square: float, degrees: int) -> float:
    """Return the normal deviate with the (two-sided) tail of a chi-square; for one degree its root."""
    if degrees == 1:
        return float(np.sqrt(max(chi_square, 0.0)))
    log_tail = float(chi2.logsf(chi_square, degrees))
    if not np.isfinite(log_tail):
        # Far out the tail of k degrees equals that of one up to a factor that hardly changes the root.
        return float(np.sqrt(max(chi_square - (degrees - 1) * np.log(max(chi_square, 2.0)), 0.0)))
    return float(-ndtri_exp(log_tail - np.log(2.0)))


def robust_deviate(square: float, degrees: int, free: float) -> float:
    """Return the normal deviate with the (two-sided) tail of Hotelling's ``square`` of ``degrees`` sizes.

    Their variances are known to ``free`` degrees of freedom, perhaps infinitely many.
    """
    if np.isinf(free):
        return deviate(square, degrees)
    log_tail = float(f.logsf(square / degrees, degrees, free))
    if log_tail == -np.inf:
        # The first term of the incomplete beta function's series, as the tail underflows.
        left = free / (free + square)
        log_tail = 0.5 * free * np.log(left) - np.log(0.5 * free) - float(betaln(0.5 * free, 0.5 * degrees))
    return float(-ndtri_exp(log_tail - np.log(2.0)))


def robust_sigmas(z: float, degrees: int, free: float) -> float:
    """Return the standard errors that give one of ``degrees`` sizes, the others 0, a deviate of ``z``."""
    tail = 2.0 * norm.sf(z)
    square = chi2.isf(tail, degrees) if np.isinf(free) else degrees * f.isf(tail, degrees, free)
    return float(np.sqrt(square))
