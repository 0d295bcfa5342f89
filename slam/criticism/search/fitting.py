"""Fits of the nuisances, and with them of any parameters, by Fisher scoring and Gauss-Newton. Candidates
for the next term are each fitted with the filter run anew.

AR(1) noise of instruments is healthy, and competes with the causes: both correlate innovations. Where the
correlation is significant, the coefficients are fitted with the nuisances. They are accepted where they
explain more than the best cause or pattern, and something in each channel of the instrument and each flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.core.progress import Tally
from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import CAMERA, FilterParameters
from slam.criticism.kalman.innovations import FilterPass, whole
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, INSTRUMENT_CHANNELS
from slam.criticism.kalman.record import Record, with_events
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import LikelihoodExpansion, ScoreTest
from slam.criticism.search.fitted_parameters import (
    AR1_COEFFICIENTS,
    MEAN_NUISANCES,
    NOISE_NUISANCES,
    NUISANCES,
    FittedParameter,
    fitted_parameter,
)
from slam.criticism.search.information import fisher_information
from slam.criticism.search.quadratic_likelihood import QuadraticLikelihood
from slam.criticism.search.thresholds import VERY_SIMILAR_NATS, similar_nats

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
    """Return the most probable nuisances within their ranges, from the first parts of flights.

    Where flights are long, the last round is fitted to all of them. Those of ``effects`` that increase noise,
    or free a nuisance of its range, are fitted too. The others keep their size in ``start``, which comes from
    all flights: the first parts may lack the manoeuvre that shows it.
    """
    effects = [e for e in effects if e.changes or e.relaxes]
    short = first_parts(records, FIRST_S)
    parameters = model if start is None else start
    rounds = [short] * (OUT_OF_MODEL_ROUNDS if model.out_of_model else ROUNDS)
    if not model.out_of_model and sum(record.duration_s for record in records) > LONG_S:
        rounds[-1] = list(records)
    for flights in rounds:
        fisher = fisher_information(flights, parameters, effects, NUISANCES)
        maximum = QuadraticLikelihood(fisher, parameters, model, NUISANCES).maximise(effects)
        for column, move in zip(maximum.columns, maximum.step, strict=True):
            fitted = fitted_parameter(column)
            if fitted in NOISE_NUISANCES:
                low, high = fitted.healthy_range(model) if model.out_of_model else (-np.inf, np.inf)
                at = fitted.value_in(parameters)
                move = np.clip(np.clip(move, -LARGEST_STEP, LARGEST_STEP), low - at, high - at)
            parameters = fitted.stepped(parameters, fitted.bounded(float(move), parameters))
    return parameters


def refit(
    records: Sequence[Record],
    model: FilterParameters,
    parameters: FilterParameters,
    effects: Sequence[Effect],
) -> tuple[float, FilterParameters]:
    """Fit terms and nuisances of the mean by Gauss-Newton; return log likelihood and parameters."""
    for effect in (e for e in effects if e.is_profiled):
        parameters = fitted_parameter(effect.columns[0]).stepped(parameters, 1.0)  # the value of its grid
    effects = [e.free for e in effects]
    best: tuple[float, FilterParameters] | None = None
    share, trial = 1.0, parameters
    for _ in range(ITERATIONS):
        fisher = fisher_information(records, trial, effects, MEAN_NUISANCES)
        quadratic = QuadraticLikelihood(fisher, trial, model, MEAN_NUISANCES)
        loose = [e for e in effects if all(c in fisher.columns for c in e.columns)]
        nats = quadratic.nats_at_current(loose)
        if best is not None and nats < best[0]:
            share *= 0.4
            if share < 0.05:
                break
        else:
            gained = np.inf if best is None else nats - best[0]
            best, share = (nats, trial), 1.0
            maximum = quadratic.maximise(loose)
            if gained < ENOUGH_NATS:
                break
        trial = best[1]
        for column, size in zip(maximum.columns, maximum.step, strict=True):
            fitted = fitted_parameter(column)
            trial = fitted.stepped(trial, share * fitted.bounded(float(size), best[1]))
    assert best is not None
    return best


def first_parts(records: Sequence[Record], together_s: float) -> list[Record]:
    """Return the first seconds of each record, so many together."""
    longest_s = together_s / len(records)
    return [with_events(r, r.times_s <= r.times_s[0] + longest_s) for r in records]


@dataclass(frozen=True)
class BestCandidate:
    """The candidate that explains most once each is fitted with the filter run anew."""

    effect: Effect
    parameters: FilterParameters
    """Filter parameters with it."""
    rivals: tuple[str, ...]
    """Names of terms that explain as much, but for what a misfit explains."""
    leads: dict[tuple[str, str], float]
    """As ``SearchResult.leads``."""


def best_candidate(
    records: Sequence[Record], expansion: LikelihoodExpansion, chosen: Sequence[Effect],
    ranked: Sequence[ScoreTest], tries: Tally,
) -> BestCandidate:  # fmt: skip
    """Fit each of the best of ``ranked`` beside the chosen terms, and choose the one that explains most.

    Among candidates that explain the same, the one with fewest parameters is chosen.
    """
    named: dict[str, ScoreTest] = {}
    for test in ranked:
        named.setdefault(test.effect.name + str(len(test.effect.columns)), test)
    if ranked[0].effect.columns[0] in CAMERA:
        # Pictures are nearly linear: a candidate far below the best of one expansion is none.
        named = {k: v for k, v in named.items() if v.nats > WORTH_A_FIT * ranked[0].nats}
    base, _ = refit(records, expansion.model, expansion.parameters, chosen)
    fitted: dict[ScoreTest, FilterParameters] = {}
    for test in tries.each(list(named.values())[:CANDIDATES]):
        nats, parameters = refit(records, expansion.model, expansion.parameters, [*chosen, test.effect])
        fitted[replace(test, nats=nats - base)] = parameters
    alike = max(fit.worth for fit in fitted) - VERY_SIMILAR_NATS
    best = min((f for f in fitted if f.worth > alike), key=lambda f: (len(f.effect.columns), -f.worth))
    known = [fit for fit in fitted if fit.effect.is_term]
    alike -= similar_nats(np.sqrt(2.0 * max(best.worth, 0.0))) - VERY_SIMILAR_NATS
    rivals = {fit.effect.name for fit in known if fit.worth > alike} - {best.effect.name}
    leads = {(best.effect.label, f.effect.label): best.worth - f.worth for f in known if f is not best}
    if not best.effect.is_term:
        leads = {}
    return BestCandidate(best.effect, fitted[best], tuple(sorted(rivals)), leads)


MIN_AR1 = 0.05
"""Least AR(1) coefficient. A smaller one exaggerates innovations by a twentieth at most: it is none."""
STANDS_OUT = 3.0
"""Least normal deviate of the lag-one correlation in every channel of an instrument."""
LEAD_NATS = 20.0
"""Lead by which AR(1) noise must exceed the best other explanation."""


def ar1_effects(parameters: FilterParameters) -> tuple[Effect, ...]:
    """Return the AR(1) coefficients of the instruments with correlated noise, as effects to be fitted."""
    return tuple(_effect(n) for n in AR1_COEFFICIENTS if n.value_in(parameters) > 0.0)


def with_ar1_noise(
    expansion: LikelihoodExpansion, chosen: Sequence[Effect], most_nats: float
) -> FilterParameters | None:
    """Return an expansion's parameters with AR(1) noise; None where something else explains more.

    The parameters hold the ``chosen`` terms. ``most_nats`` is the gain of the best other explanation.
    Instruments of an out-of-model vehicle are not tested.
    """
    model, passes = expansion.model, expansion.fisher.passes
    records = [run.record for run in passes]
    correlation, deviate = lag_one_correlation(passes)
    seen = [] if model.out_of_model else [n for n in AR1_COEFFICIENTS if _stands_out(n, correlation, deviate)]
    # AR(1) noise explains about half the squared deviates: no fit where even twice that is too little.
    if np.nansum(deviate[[c for n in seen for c in _channels(n)]] ** 2) < most_nats:
        return None
    while seen:
        correlated = fit_nuisances(records, model, expansion.parameters, [*chosen, *map(_effect, seen)])
        correlated = without_small_ar1(correlated)
        gained = _gained(passes, correlated)
        kept = [n for n in seen if n.value_in(correlated) > 0.0 and _everywhere(gained[:, _channels(n)])]
        if kept == seen:
            break
        seen = kept
    # A gain of the refitted nuisances elsewhere does not count for AR(1) noise; a loss does.
    own = [channel for n in seen for channel in _channels(n)]
    if not seen or min(gained[:, own].sum(), gained.sum()) < most_nats + LEAD_NATS:
        return None
    return without_small_ar1(fit_nuisances(records, model, correlated, [*chosen, *ar1_effects(correlated)]))


def without_small_ar1(parameters: FilterParameters) -> FilterParameters:
    """Set negligible AR(1) coefficients to zero: they were fitted while a cause was absent."""
    correlation = parameters.noise_correlation
    return replace(parameters, noise_correlation=np.where(correlation < MIN_AR1, 0.0, correlation))


def lag_one_correlation(passes: Sequence[FilterPass]) -> tuple[Array, Array]:
    """Return (channels,) lag-one correlations of the innovations and their normal deviates; NaN for none."""
    products, pairs, squares = (np.zeros(len(CHANNELS)) for _ in range(3))
    for run in passes:
        for k in range(len(CHANNELS)):
            _, white, status = run.of_channel(k)
            white = np.where(status == USED, white, np.nan)
            product = white[1:] * white[:-1]
            products[k] += np.nansum(product)
            pairs[k] += np.isfinite(product).sum()
            squares[k] += np.nansum(white**2)
    with np.errstate(invalid="ignore"):
        correlation = products / squares
    return correlation, correlation * np.sqrt(pairs)


def _channels(nuisance: FittedParameter) -> list[int]:
    return list(INSTRUMENT_CHANNELS[nuisance.entries[0]])


def _stands_out(nuisance: FittedParameter, correlation: Array, deviate: Array) -> bool:
    """Whether the noise of all channels of an instrument looks correlated. Some may look so much less than
    others, where the process noise has absorbed a part."""
    own = [channel for channel in _channels(nuisance) if np.isfinite(deviate[channel])]
    return bool(own and deviate[own].min() > STANDS_OUT and correlation[own].mean() > MIN_AR1)


def _effect(coefficient: FittedParameter) -> Effect:
    return Effect(coefficient.name, changes=(coefficient,), positive=True)


def _gained(before: Sequence[FilterPass], correlated: FilterParameters) -> Array:
    """Return (flights, channels) gains in nats over the runs before, from the readings that both use."""
    after = in_threads(lambda old: whole(old.record, correlated), before)
    nats = np.zeros((len(before), len(CHANNELS)))
    for flight, (old, new) in enumerate(zip(before, after, strict=True)):
        events, c = np.nonzero((old.status == USED) & (new.status == USED))
        channels = CHANNEL_AT[old.record.kinds[events], c]
        np.add.at(nats[flight], channels, (new.nats - old.nats)[events, c])
    return nats


def _everywhere(gained: Array) -> bool:
    """Whether AR(1) noise explains something in each channel of an instrument and each flight. An effect acts
    on some axes and at some times."""
    parts = np.concatenate([gained.sum(axis=0), gained.sum(axis=1)])
    return bool((parts[parts != 0.0] > 0.0).all())
