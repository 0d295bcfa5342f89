"""Thresholds and costs of hypotheses.

The thresholds of terms and residual patterns are calibrated on simulated healthy flights and shipped with the
package. Priors and costs of parameters are in nats.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np
from scipy.special import betaln, ndtri_exp
from scipy.stats import chi2, f, norm

from slam.simulation.terms import CATALOGUE

CHANCE = "what chance reaches once in a hundred healthy cases"
KNOWN, UNKNOWN = 0.9, 0.1
"""Prior probabilities of an effect of the catalogue and of anything else."""
ONE_OF_ALL = float(np.log(len(CATALOGUE) / KNOWN))
"""Cost in nats of one term of the catalogue out of all."""
VERY_SIMILAR_NATS = 4.0
"""Lead below which two explanations are taken as alternatives."""
SIZE_PRIOR = 100.0
"""Prior variance of an effect's size in units of its standard error: sizes of up to about 20 sigma."""


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of z, at a false-alarm rate of 1 % for terms and residual patterns together."""

    effects: float
    """Threshold of the greatest of all terms."""
    patterns: float
    """Threshold of the greatest of the residual patterns."""
    second: float
    """Threshold of one more term beside one that was found."""
    pairs: float
    """Threshold of two terms together that mask each other."""
    meaning: str = CHANCE
    """Description of the thresholds."""

    def times(self, factor: float, why: str) -> Thresholds:
        """Return all thresholds times a factor, described by ``why``."""
        four = [factor * z for z in (self.effects, self.patterns, self.second, self.pairs)]
        return Thresholds(four[0], four[1], four[2], four[3], f"{factor:g} times {self.meaning}, as {why}")


def load_thresholds(pictures: bool = False) -> Thresholds:
    """Return the shipped thresholds, for flights without or with pictures."""
    text = resources.files("slam.criticism.search").joinpath("thresholds.toml").read_text(encoding="utf-8")
    table, suffix = tomllib.loads(text), "_with_pictures" * pictures
    effects, patterns = float(table["effects"]), float(table[f"shapes{suffix}"])
    return Thresholds(effects, patterns, float(table["second"]), float(table[f"pairs{suffix}"]))


MISFIT = 0.05
"""Share of a real effect that its equation in the catalogue does not describe."""


def with_misfit(threshold: float, greatest: float) -> float:
    """Return the threshold beside a cause with a z of ``greatest``, whose own misfit is included."""
    return float(np.hypot(threshold, MISFIT * greatest))


def similar_nats(z: float) -> float:
    """Return the lead in nats that the misfit of a cause with a z of ``z`` explains.

    Sensitivities that differ by d sigma give the true one a lead of d^2 / 2, and a misfit m the other one up
    to d m: together 2 m^2 for the d at which both are equal.
    """
    return max(VERY_SIMILAR_NATS, 2.0 * (MISFIT * z) ** 2)


def parameter_cost(degrees: int) -> float:
    """Return the cost in nats of ``degrees`` fitted parameters."""
    return 0.5 * degrees * float(np.log1p(SIZE_PRIOR))


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
