"""Thresholds and costs of hypotheses.

The thresholds of terms and residual patterns are calibrated on simulated healthy flights and shipped with the
package. Priors and costs of parameters are in nats.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np

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
