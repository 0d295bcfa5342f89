"""Pairs of terms: two terms may mask each other, or a third may look like both together.

The search takes one term after the other. A sonar that warms makes a vehicle seem to sink, and a climb
stronger than the descent makes it rise. Alone neither may be significant, or a term may be that is like their
sum. Pairs are therefore hypotheses of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest
from slam.criticism.search.thresholds import Thresholds
from slam.simulation.terms import CATALOGUE


def ranked_pairs(
    expansion: LikelihoodExpansion, rest: Sequence[Effect], without: Effect | None = None
) -> list[ScoreTest]:
    """Return tests of all pairs of terms with a slope in the mean, best first; ``without`` is in none."""
    excluded = [*rest, without] if without is not None else rest
    known = [
        e for e in expansion.effects
        if e.is_term and e.perturbations and not e.is_profiled and
        not any(map(e.repeats, excluded))
    ]  # fmt: skip
    pairs = [(one, other) for one, other in combinations(known, 2) if not one.repeats(other)]
    return [test for test in expansion.score_tests(rest, pairs) if test.nats > 0.0]


def masked_pair(
    expansion: LikelihoodExpansion, limits: Thresholds, alone: Sequence[ScoreTest] = ()
) -> tuple[Effect, ...] | None:
    """Return the best pair of terms that mask each other, or None.

    It must explain more than the best of ``alone``, the terms that are significant by themselves, best first.
    """
    least = max((s.worth for s in alone), default=-np.inf) + np.log(len(CATALOGUE))
    worthy = (pair for pair in ranked_pairs(expansion, []) if pair.worth > least and pair.z >= limits.pairs)
    return next((pair.effects for pair in worthy if mask_each_other(expansion, pair.effects, limits)), None)


def mask_each_other(expansion: LikelihoodExpansion, two: Sequence[Effect], limits: Thresholds) -> bool:
    """Whether two terms are significant together, each beside the other, and one of them not alone."""
    one, other = two
    together = expansion.score_tests([], [(one, other)])[0]
    alone = min(expansion.score_tests([], [e])[0].z for e in two)
    beside = min(expansion.score_tests([one], [other])[0].z, expansion.score_tests([other], [one])[0].z)
    return alone < limits.effects <= beside and together.z >= limits.pairs
