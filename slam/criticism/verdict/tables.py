"""Tables of a verdict: hypotheses ranked, the vehicle's own constants, and whiteness of the innovations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from slam.criticism.cause import Cause, Interval
from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.readings import CHANNELS, INSTRUMENTS
from slam.criticism.kalman.record import Record
from slam.criticism.search.correlated_noise import lag_one_correlation
from slam.criticism.search.expansion import LikelihoodExpansion
from slam.criticism.search.fitted_parameters import NUISANCES
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.criticism import ChannelCheck, Rank
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.simulation.terms import CATALOGUE

TENTHS = 10


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
    return tuple(sorted(ranks, key=lambda r: (-r.probability, -r.z, r.name)))


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
