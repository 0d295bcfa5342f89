"""Pairs of terms: two terms may mask each other, or a third may look like both together.

The search takes one term after the other. A sonar that warms makes a vehicle seem to sink, and a climb
stronger than the descent makes it rise. Alone neither may be significant, or a term may be that is like their
sum. Pairs are therefore hypotheses of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest, backwards
from slam.criticism.search.thresholds import Thresholds, deviate, parameter_cost
from slam.simulation.terms import CATALOGUE

Two = tuple[Effect, Effect]


class Pair(NamedTuple):
    """Two terms, and what they explain beside others."""

    terms: Two
    nats: float
    z: float

    @property
    def worth(self) -> float:
        """Nats less the cost of the parameters."""
        return self.nats - sum(parameter_cost(len(e.columns)) for e in self.terms)


def ranked_pairs(
    expansion: LikelihoodExpansion, rest: Sequence[Effect], without: Effect | None = None
) -> list[Pair]:
    """Return all pairs of terms that move the mean of readings and have a slope, best first; ``without`` is
    in none."""
    excluded = [*rest, without] if without is not None else rest
    known = [
        e for e in expansion.effects
        if e.is_term and e.perturbations and not e.is_profiled and
        not any(map(e.repeats, excluded))
    ]  # fmt: skip
    base = expansion.quadratic.maximise(rest).nats
    found = []
    for one, other in combinations(known, 2):
        maximum = expansion.quadratic.maximise([*rest, one, other])
        if not (
            one.repeats(other) or backwards(one, expansion, maximum) or backwards(other, expansion, maximum)
        ):
            found.append(_pair((one, other), maximum.nats - base))
    return sorted(found, key=lambda pair: -pair.worth)


def masked_pair(
    expansion: LikelihoodExpansion, limits: Thresholds, alone: Sequence[ScoreTest] = ()
) -> Two | None:
    """Return the best pair of terms that mask each other, or None.

    It must explain more than the best of ``alone``, the terms that are significant by themselves, best first.
    """
    least = max((s.worth for s in alone), default=-np.inf) + np.log(len(CATALOGUE))
    worthy = (pair for pair in ranked_pairs(expansion, []) if pair.worth > least and pair.z >= limits.pairs)
    return next((pair.terms for pair in worthy if mask_each_other(expansion, pair.terms, limits)), None)


def mask_each_other(expansion: LikelihoodExpansion, two: Sequence[Effect], limits: Thresholds) -> bool:
    """Whether two terms are significant together, each beside the other, and one of them not alone."""
    one, other = two
    together = _pair(
        (one, other), expansion.quadratic.maximise(two).nats - expansion.quadratic.maximise([]).nats
    )
    alone = min(expansion.score_tests([], [e])[0].z for e in two)
    beside = min(expansion.score_tests([one], [other])[0].z, expansion.score_tests([other], [one])[0].z)
    return alone < limits.effects <= beside and together.z >= limits.pairs


def _pair(terms: Two, nats: float) -> Pair:
    nats = max(nats, 0.0)
    return Pair(terms, nats, deviate(2 * nats, sum(len(e.columns) for e in terms)))
