"""Tables of a verdict: ranked hypotheses, the vehicle's own constants, whiteness of the innovations, and
statistical power: the smallest detectable sizes of terms, and terms that the flights cannot separate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import ndtr

from slam.criticism.cause import Cause, Interval
from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.readings import CHANNELS, INSTRUMENTS
from slam.criticism.kalman.record import Record
from slam.criticism.search.correlated_noise import lag_one_correlation
from slam.criticism.search.effects import Effect, catalogue_value
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import AT, NUISANCES
from slam.criticism.search.quadratic_likelihood import SEEN
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.criticism import ChannelCheck, Rank
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.simulation.terms import CATALOGUE

TENTHS = 10
CONFUSED = 0.9
LEAST_SHARE = 1e-6
"""Least share of a column's information that the nuisances must leave for it to be seen."""
NINE_OF_TEN = 1.28
"""Standard deviations beyond a threshold that nine of ten cases exceed."""


def ranking(
    found: SearchResult, probability: dict[str, float], anomalies: Sequence[Cause]
) -> tuple[Rank, ...]:
    """Return all terms, "nothing" and "something else", by probability and by their score test alone.

    ``anomalies``: the causes that single readings show; "nothing" requires that there is none of these
    either.
    """
    seen = {cause.name: cause for cause in anomalies}
    healthy = float(np.prod([1.0 - cause.probability for cause in seen.values()]))
    probability = probability | {NOTHING: healthy * probability.get(NOTHING, 0.0)}
    z = {name: seen[name].z if name in seen else 0.0 for name, t in CATALOGUE.items() if t.in_single_readings}
    tests = [s for s in found.first.score_tests([], found.first.effects) if s.effect.is_term]
    z |= {test.effect.name: test.z for test in sorted(tests, key=lambda s: s.z)}
    ranks = [
        Rank(name, probability.get(name, 0.0), z.get(name, 0.0)) for name in (*z, NOTHING, SOMETHING_ELSE)
    ]
    return tuple(sorted(ranks, key=lambda r: (-round(r.probability, 6), -round(r.z, 3), r.name)))


def fitted_nuisances(found: SearchResult, best: RolloutFit | None) -> dict[str, Interval]:
    """Return this vehicle's own constants with their 95 % intervals."""
    expansion = found.last
    maximum = expansion.quadratic.maximise(found.chosen)
    step, covariance = maximum.of(expansion.quadratic.index(expansion.quadratic.names))
    values: dict[str, Interval] = {}
    for k, nuisance in enumerate(NUISANCES):
        x, std = expansion.quadratic.at[k] + step[k], 1.96 * float(np.sqrt(covariance[k, k]))
        if best is not None and nuisance.name in best.std:
            x, std = nuisance.value_in(best.parameters), 1.96 * best.std[nuisance.name]
        ends = [x, x - std, x + std]
        if nuisance.form == "log":
            ends = [float(np.exp(e)) for e in ends]
        values[nuisance.name] = Interval(float(ends[0]), nuisance.unit, float(ends[1]), float(ends[2]))
    return values


def checks(records: Sequence[Record], expansion: LikelihoodExpansion) -> tuple[ChannelCheck, ...]:
    """Check that each channel's whitened innovations are white: mean square, lag-one correlation and
    distribution (the probability integral transform, Dawid 1984)."""
    correlation, _ = lag_one_correlation(records, expansion.fisher.passes)
    found = []
    for channel, name in enumerate(CHANNELS):
        flights = zip(records, expansion.fisher.passes, strict=True)
        each = [run.of_channel(record, channel) for record, run in flights]
        white = np.concatenate([innovations[status == USED] for _, innovations, status in each])
        if len(white) > 1:
            square, next_one = float(np.mean(white**2)), float(correlation[channel])
            tenths = np.histogram(ndtr(white), bins=TENTHS, range=(0.0, 1.0))[0] / len(white)
            found.append(ChannelCheck(name, len(white), square, next_one, tuple(tenths.tolist())))
    return tuple(found)


def noise_correlations(parameters: FilterParameters) -> dict[str, float]:
    """Return the correlation of successive readings of each instrument that has one."""
    each = zip(INSTRUMENTS, parameters.noise_correlation.tolist(), strict=True)
    return {instrument: correlation for instrument, correlation in each if correlation > 0.0}


def detectable(expansion: LikelihoodExpansion, threshold: float) -> dict[str, tuple[float, str]]:
    """Return the smallest size of each term that nine of ten cases would have shown, and its unit."""
    found: dict[str, tuple[float, str]] = {}
    for effect in expansion.effects:
        if not effect.is_term or effect.is_profiled:
            continue
        columns = expansion.quadratic.index(effect.columns)
        _, covariance = expansion.quadratic.maximise([effect]).of(columns)
        # The component of a vector that shows least decides.
        k = int(np.argmax(np.diag(covariance)))
        size = (threshold + NINE_OF_TEN) * float(np.hypot(np.sqrt(covariance[k, k]), effect.tolerance))
        neutral = catalogue_value(effect, k, 0.0, expansion.parameters, 0.0)
        value = abs(catalogue_value(effect, k, size, expansion.parameters, 0.0) - neutral)
        parameter = CATALOGUE[effect.name].parameter(effect.parameters[k])
        if np.isfinite(value) and value < 10 * max(abs(parameter.most), abs(parameter.least)):
            kept = found.get(effect.name)
            found[effect.name] = (min(value, kept[0]) if kept else value), parameter.unit
    shown = [
        (float(e.columns[0].partition(AT)[2]), e.name)
        for e in expansion.effects
        if e.is_saturation and e.is_profiled
        and _score_at_tried_size(expansion, e) > threshold + NINE_OF_TEN
    ]  # fmt: skip
    # The highest limit that shows is the smallest effect.
    return found | {name: (limit, "rad") for limit, name in sorted(shown)}


def _score_at_tried_size(expansion: LikelihoodExpansion, effect: Effect) -> float:
    """Return the score test of an effect of one column at the size that it is tried at."""
    _, covariance = expansion.quadratic.maximise([effect]).of(expansion.quadratic.index(effect.columns))
    return float(float(covariance[0, 0]) ** -0.5)


def confusable(expansion: LikelihoodExpansion) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of terms whose sensitivities correlate by more than ``CONFUSED`` here, nuisances projected
    out."""
    # Without a score every nuisance stays in its range, so that its prior alone holds it.
    quadratic = replace(expansion.quadratic, score=np.zeros_like(expansion.quadratic.score))
    seen: dict[str, Effect] = {}
    for effect in expansion.effects:
        if not effect.is_term or effect.is_profiled or effect.relaxes or effect.name in seen:
            continue
        columns = quadratic.index(effect.columns)
        _, covariance = quadratic.maximise([effect]).of(columns, white=True)
        information, left = np.diag(quadratic.information)[columns], np.diag(np.linalg.inv(covariance))
        if ((information > SEEN) & (left > LEAST_SHARE * information)).all():
            seen[effect.name] = effect
    pairs = [(a, b, quadratic.correlation(seen[a], seen[b])) for a, b in combinations(sorted(seen), 2)]
    return tuple(sorted((p for p in pairs if p[2] > CONFUSED), key=lambda p: -p[2]))


def within_reach(detectable: Mapping[str, tuple[float, str]]) -> dict[str, float]:
    """Return the terms that would have shown at a usual size, with the smallest size as a share of the
    greatest usual one.

    The most sharply tested term is first.
    """
    shares = {}
    for name, (size, unit) in detectable.items():
        sizes = [p for p in CATALOGUE[name].parameters if p.unit == unit]
        usual = max(max(abs(p.low - p.neutral), abs(p.high - p.neutral)) for p in sizes)
        # The lower a limit, the greater is its effect.
        shares[name] = sizes[0].low / size if sizes[0].is_limit else size / usual
    return dict(sorted((item for item in shares.items() if item[1] <= 1.0), key=lambda item: item[1]))
