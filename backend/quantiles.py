"""Chi-square, F and binomial distributions, without the long import of scipy.stats.

Source: Abramowitz and Stegun 1964, sections 26.4 to 26.6 (by the incomplete gamma and beta functions).
"""

from __future__ import annotations

from scipy.special import betainc, betaincinv, gammaincc, gammainccinv, gammaincinv


def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the value that a chi-square variable of ``dof`` degrees of freedom stays below."""
    return 2 * float(gammaincinv(dof / 2, probability))


def chi_square_limit(probability: float, dof: float) -> float:
    """Return the value that a chi-square variable of ``dof`` degrees of freedom exceeds, exact for small
    probabilities."""
    return 2 * float(gammainccinv(dof / 2, probability))


def chi_square_tail(value: float, dof: float) -> float:
    """Return the probability that a chi-square variable of ``dof`` degrees of freedom exceeds a value."""
    return float(gammaincc(dof / 2, value / 2))


def f_limit(probability: float, dof: float, dof_noise: float) -> float:
    """Return the value that the ratio of two independent variances exceeds, exact for small probabilities.

    ``dof`` and ``dof_noise``: degrees of freedom of the numerator and of the denominator.
    """
    share = float(betaincinv(dof_noise / 2, dof / 2, probability))
    return dof_noise * (1 - share) / (dof * share)


def f_tail(value: float, dof: float, dof_noise: float) -> float:
    """Return the probability that the ratio of two independent variances exceeds a value, as `f_limit`."""
    return float(betainc(dof_noise / 2, dof / 2, dof_noise / (dof_noise + dof * value)))


def binomial_tail(least: int, count: int, probability: float) -> float:
    """Return the probability that at least ``least`` of ``count`` events happen, each of one probability."""
    return float(betainc(least, count - least + 1, probability)) if least > 0 else 1.0
