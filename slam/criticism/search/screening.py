"""Information of a term once the nuisances are marginalised, and the normal deviate of a chi-square.

Let G be the information of the nuisances N (prior precision L) and of a term J. What is left of the term is
G_JJ - G_JN (G_NN + L)^-1 G_NJ. A chi-square with a degree of freedom for each of a term's columns becomes a
normal deviate z of the same tail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr
from scipy.stats import chi2, norm

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RIDGE = 1e-9
"""Least share of a column's information that must be left to separate it from the others."""
LEAST_SHARE = 1e-6


@dataclass(frozen=True)
class Projected:
    """Columns with others projected out."""

    information: Array
    """(p, p)."""
    share: Array
    """(p,) remaining share of each column's information."""


def project(information: Array, out: Ints, precision: Array) -> Projected:
    """Project the columns ``out``, with prior precisions, out of all others."""
    a = information[np.ix_(out, out)] + np.diag(precision)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(a), 1e-300))
    a = a * scale[:, None] * scale + RIDGE * np.eye(len(out))
    cross = information[:, out] * scale
    solved = np.linalg.solve(a, cross.T)
    left = information - cross @ solved
    before = np.maximum(np.diag(information), 1e-300)
    return Projected(left, np.diag(left) / before)


def deviate(chi_square: float, degrees: int) -> float:
    """Return the normal deviate with the (two-sided) tail of a chi-square; for one degree its root."""
    if degrees == 1:
        return float(np.sqrt(max(chi_square, 0.0)))
    log_tail = float(chi2.logsf(chi_square, degrees))
    if not np.isfinite(log_tail):
        # Far out the tail of k degrees equals that of one up to a factor that hardly changes the root.
        return float(np.sqrt(max(chi_square - (degrees - 1) * np.log(max(chi_square, 2.0)), 0.0)))
    if log_tail > np.log(1e-300):
        return float(norm.isf(np.exp(log_tail) / 2.0))
    z = np.sqrt(chi_square)
    for _ in range(20):
        z -= (float(log_ndtr(-z)) + np.log(2.0) - log_tail) / -(z + 1.0 / z)
    return float(z)


def _regular(a: Array) -> Array:
    return np.asarray(a + np.diag(RIDGE * np.diag(a) + 1e-12))


def correlation(left: Array, a: Ints, b: Ints) -> float:
    """Return the greatest canonical correlation of two terms' projected sensitivities."""
    ga = np.linalg.cholesky(_regular(left[np.ix_(a, a)]))
    gb = np.linalg.cholesky(_regular(left[np.ix_(b, b)]))
    between = np.linalg.solve(ga, np.linalg.solve(gb, left[np.ix_(b, a)]).T)
    return float(np.clip(np.linalg.norm(between, 2), 0.0, 1.0))
