"""Fits of the nuisances, and with them of any parameters, by Fisher scoring and Gauss-Newton. Candidates
for the next term are each fitted with the filter run anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam.core.progress import Tally
from slam.criticism.kalman.filter_parameters import CAMERA, FilterParameters
from slam.criticism.kalman.record import Record, with_events
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest
from slam.criticism.search.fitted_parameters import (
    MEAN_NUISANCES,
    MEAN_PERTURBATIONS,
    NOISE_NUISANCES,
    NUISANCES,
    FittedParameter,
    fitted_parameter,
)
from slam.criticism.search.information import FisherInformation, fisher_information
from slam.criticism.search.quadratic_likelihood import QuadraticLikelihood, quadratic_likelihood
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS, similar_nats

Array = NDArray[np.float64]

FIRST_S = 60.0
"""Duration of the first parts of flights to which the process noise is fitted first: it shows everywhere."""
LONG_S = 180.0
"""Duration of all flights beyond which noise is fitted to all of them. Otherwise a small error of its size,
fitted to the first parts, shows as a pattern. Ten healthy flights of a minute were ``unknown``, z 6.0, by a
tilt that feeds itself."""
ROUNDS = 2
OUT_OF_MODEL_ROUNDS = 7
LARGEST_STEP = 0.5
"""Greatest change of a logarithm in one round."""
ITERATIONS = 8
ENOUGH_NATS = 0.5
CANDIDATES = 5
WORTH_A_FIT = 0.25


def fit_nuisances(
    records: Sequence[Record],
    model: FilterParameters,
    start: FilterParameters | None = None,
    effects: Sequence[Effect] = (),
) -> FilterParameters:
    """Return the most probable nuisances within their ranges, from the first parts of flights, of long ones
    from all.

    Those of ``effects`` that increase noise, or free a nuisance of its range, are fitted with them. The
    others keep their size in ``start``. It comes from all the flights; the first parts may lack the manoeuvre
    that shows it.
    """
    effects = [e for e in effects if e.changes or e.relaxes]
    short = [first_seconds(record, FIRST_S / len(records)) for record in records]
    parameters = model if start is None else start
    rounds = [short] * (OUT_OF_MODEL_ROUNDS if model.out_of_model else ROUNDS)
    if not model.out_of_model and sum(record.duration_s for record in records) > LONG_S:
        rounds[-1] = list(records)
    for flights in rounds:
        found, quadratic = _expanded(flights, model, parameters, effects, NUISANCES)
        maximum = quadratic.maximise(effects)
        for column, move in zip(maximum.columns, maximum.step, strict=True):
            fitted = fitted_parameter(found.columns[column])
            if fitted in NOISE_NUISANCES:
                low, high = fitted.healthy_range(model) if model.out_of_model else (-np.inf, np.inf)
                at = fitted.value_in(parameters)
                move = np.clip(np.clip(move, -LARGEST_STEP, LARGEST_STEP), low - at, high - at)
            parameters = fitted.stepped(parameters, fitted.bounded(float(move), parameters))
    return parameters


def _expanded(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    effects: Sequence[Effect],
    nuisances: Sequence[FittedParameter],
) -> tuple[FisherInformation, QuadraticLikelihood]:
    """Return the likelihood about ``parameters`` in effects and nuisances, those of the mean included."""
    perturbations = [*MEAN_PERTURBATIONS, *(d for e in effects for d in e.perturbations)]
    changes = [*(n for n in NOISE_NUISANCES if n in nuisances), *(c for e in effects for c in e.changes)]
    fisher = fisher_information(records, parameters, perturbations, changes)
    return fisher, quadratic_likelihood(fisher, parameters, model, {}, nuisances=nuisances)


def refit(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    effects: Sequence[Effect],
) -> tuple[float, FilterParameters]:
    """Fit terms and nuisances of the mean by Gauss-Newton; return log likelihood and parameters."""
    for effect in effects:
        parameters = effect.at_profiled_value(parameters)
    effects = [e.free for e in effects]
    best: tuple[float, FilterParameters] | None = None
    share, step, columns = 1.0, np.zeros(0), []
    trial = parameters
    for _ in range(ITERATIONS):
        fisher, quadratic = _expanded(records, model, trial, effects, MEAN_NUISANCES)
        loose = [e for e in effects if all(c in fisher.columns for c in e.columns)]
        nats = float(fisher.log_likelihood.sum()) - quadratic.penalty_at_current(
            [c for e in loose for c in e.relaxes]
        )
        if best is not None and nats < best[0]:
            share *= 0.4
            if share < 0.05:
                break
        else:
            gained = np.inf if best is None else nats - best[0]
            best, share = (nats, trial), 1.0
            maximum = quadratic.maximise(loose)
            columns, step = [fisher.columns[c] for c in maximum.columns], maximum.step
            if gained < ENOUGH_NATS:
                break
        trial = best[1]
        for column, size in zip(columns, step, strict=True):
            fitted = fitted_parameter(column)
            trial = fitted.stepped(trial, share * fitted.bounded(float(size), best[1]))
    assert best is not None
    return best


def first_seconds(record: Record, longest_s: float) -> Record:
    """Return the record's first seconds."""
    return with_events(record, record.times_s <= record.times_s[0] + longest_s)


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
