"""Candidates for the next term, each fitted with the filter run anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam.core.progress import Tally
from slam.criticism.kalman.filter_parameters import CAMERA, FilterParameters
from slam.criticism.kalman.record import Record
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest
from slam.criticism.search.fitting import refit
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS, similar_nats

CANDIDATES = 5
WORTH_A_FIT = 0.25


class _Fit(NamedTuple):
    """A candidate, fitted with the filter run anew."""

    worth: float
    effect: Effect
    parameters: FilterParameters


class BestCandidate(NamedTuple):
    """The candidate that explains most once each is fitted with the filter run anew."""

    effect: Effect
    parameters: FilterParameters
    """Filter parameters with it."""
    rivals: tuple[str, ...]
    """Names of terms that explain as much, but for what a misfit explains."""
    leads: dict[tuple[str, str], float]
    """Leads as in ``SearchResult.leads``."""


def best_candidate(
    records: Sequence[Record],
    model: FilterParameters,
    expansion: LikelihoodExpansion,
    chosen: Sequence[Effect],
    ranked: Sequence[ScoreTest],
    tries: Tally,
) -> BestCandidate:
    """Fit each of the best of ``ranked`` beside the chosen terms, and choose the one that explains most.

    Among candidates that explain the same, the one with fewest parameters is chosen.
    """
    named: dict[str, ScoreTest] = {}
    for test in ranked:
        named.setdefault(test.effect.name + str(len(test.effect.columns)), test)
    if ranked[0].effect.columns[0] in CAMERA:
        # Pictures are nearly linear: a candidate far below the best of one expansion is none.
        named = {k: v for k, v in named.items() if v.nats > WORTH_A_FIT * ranked[0].nats}
    base, _ = refit(records, model, expansion.parameters, chosen)
    fits = []
    for test in tries.each(list(named.values())[:CANDIDATES]):
        nats, parameters = refit(records, model, expansion.parameters, [*chosen, test.effect])
        fits.append(_Fit(replace(test, nats=nats - base).worth, test.effect, parameters))
    alike = max(fit.worth for fit in fits) - VERY_SIMILAR_NATS
    best = min((f for f in fits if f.worth > alike), key=lambda f: (len(f.effect.columns), -f.worth))
    known = [fit for fit in fits if fit.effect.is_term]
    alike -= similar_nats(np.sqrt(2.0 * max(best.worth, 0.0))) - VERY_SIMILAR_NATS
    rivals = {fit.effect.name for fit in known if fit.worth > alike} - {best.effect.name}
    leads = {(best.effect.label, f.effect.label): best.worth - f.worth for f in known if f is not best}
    if not best.effect.is_term:
        leads = {}
    return BestCandidate(best.effect, best.parameters, tuple(sorted(rivals)), leads)
