"""Quantiles of the chi-square distribution, without the long import of scipy.stats."""

from __future__ import annotations

from scipy.special import gammaincinv


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value that a chi-square variable of ``dof`` degrees of freedom stays below."""
    return 2 * float(gammaincinv(dof / 2, probability))
