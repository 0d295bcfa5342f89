"""Explanation of flights without a command log: the instrument errors that explain the differences between
instruments.

Each effect is a column of the whitened rows of all comparisons. The one that explains most is chosen as long
as it is significant by cluster-robust errors over segments of ten seconds, and predicts held-out parts.
Errors ahead correspond to those of roll-outs with commands: from a moment at which an instrument is trusted,
the gyro or the accelerometer alone predicts its reading. A height is predicted from two moments, the begin
and the middle: no instrument measures its initial rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.criticism.cause import Cause, ChannelError
from slam.criticism.search.effects import Effect
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import Thresholds
from slam.criticism.verdict.consistency import varying_sizes
from slam.criticism.verdict.covariate import Covariate, covariate_of
from slam.criticism.verdict.decision import CONFIRMED_NATS
from slam.criticism.verdict.explanation import Explanation
from slam.criticism.verdict.held_out import held_out
from slam.criticism.verdict.posterior import posterior_of
from slam.criticism.without_commands.likelihood import Sizes, likelihood_of, table_of
from slam.criticism.without_commands.sensor_comparison import SensorComparison, compare_sensors
from slam.criticism.without_commands.whitened_rows import NODE_S, Averages, WhitenedRows
from slam.simulation.model import Model
from slam.simulation.replay.compare import HORIZONS_S

Array = NDArray[np.float64]

STANDS_OUT_Z = 5.0
STANDS_OUT = (
    "set by hand where instruments are compared with each other: of 150 simulated healthy cases the greatest "
    "reaches 3.8"
)
"""``python -m slam.criticism.calibrate 150 9000 --without-commands``."""
LIMITS = Thresholds(STANDS_OUT_Z, np.inf, STANDS_OUT_Z, np.inf, STANDS_OUT)
MOST = 5
ROUNDS = 2


@dataclass(frozen=True)
class ComparedFlights:
    """Flights whose instruments were compared with each other."""

    sensors: SensorComparison
    rows: list[list[WhitenedRows]]
    """Rows of each flight, linear about the effects that were found."""


def explain_comparisons(
    flights: Sequence[Flight], model: Model, progress: Progress = silent
) -> tuple[ComparedFlights, Explanation] | None:
    """Return the comparisons and the effects that explain them; None where no two instruments of the flights
    can be compared.

    Pictures are linear only near the truth, so their rows are computed anew about what was found.
    """
    sensors = compare_sensors(flights, model, progress)
    rows = sensors.rows({})
    if not any(rows):
        return None
    found = search_linear(likelihood_of(rows, sensors.parameters))
    for _ in range(ROUNDS if sensors.matches is not None and found.chosen else 0):
        rows = sensors.rows(found.last.quadratic.sizes(found.chosen))
        found = search_linear(likelihood_of(rows, sensors.parameters))
    return ComparedFlights(sensors, rows), Explanation(
        found, sensors.parameters, posterior_of(found), {}, None
    )


def search_linear(found: SearchResult) -> SearchResult:
    """Choose the significant effects, the greatest first, where everything is linear."""
    expansion, chosen = found.last, list[Effect]()
    while len(chosen) < MOST and (best := _next(replace(found, chosen=tuple(chosen)))) is not None:
        chosen.append(best)
    for effect in list(chosen):
        # A term that led alone may lag behind another beside the rest.
        rest = [e for e in chosen if e is not effect]
        chosen[chosen.index(effect)] = expansion.score_tests(rest, expansion.effects)[0].effect
    return replace(found, chosen=tuple(chosen))


def _next(found: SearchResult) -> Effect | None:
    """Return the effect that explains most beside the chosen ones, among those that stand out and predict
    held-out parts; None where there is none."""
    for test in found.last.score_tests(found.chosen, found.last.effects):
        more = replace(found, chosen=(*found.chosen, test.effect))
        if test.z >= STANDS_OUT_Z and held_out((), more, found.chosen).total >= CONFIRMED_NATS:
            return test.effect
    return None


def with_varying_sizes(cause: Cause, found: SearchResult) -> Cause:
    """Widen the intervals of sizes that vary between segments.

    Another error comes and goes there, so the segments are no independent measurements of one size. The
    interval must hold the sizes of most segments, not their mean.
    """
    effect = next(e for e in found.chosen if e.name == cause.name)
    varying, parameters = varying_sizes(found, effect), dict(cause.parameters)
    for name, column in zip(effect.parameters, effect.columns, strict=True):
        if column in varying:
            p, factor = parameters[name], float(np.sqrt(len(varying[column])))
            low, high = p.value - factor * (p.value - p.low), p.value + factor * (p.high - p.value)
            parameters[name] = replace(p, low=low, high=high)
    return replace(cause, parameters=parameters)


def covariate_in_comparisons(
    rows: Sequence[Sequence[WhitenedRows]], found: SearchResult, lead: Cause
) -> Covariate | None:
    """Return the covariates of the leading cause and its rival in the differences between instruments; None
    where single readings show the cause."""
    cause, rival = lead.name, lead.rival
    if all(e.name != cause for e in found.chosen):
        return None
    known = {e.name: e for e in found.last.effects}
    rest = [e for e in found.chosen if e.name != cause]
    models = {"": rest, cause: [*rest, known[cause]]} | ({rival: [*rest, known[rival]]} if rival else {})
    off = np.concatenate([r.off for flight in rows for r in flight])
    kind = np.concatenate([np.full(len(r.off), r.kind) for flight in rows for r in flight])
    residuals = {}
    for name, effects in models.items():
        sizes = found.last.quadratic.sizes(effects)
        residuals[name] = off - table_of(rows, list(sizes)) @ np.array(list(sizes.values()))
    pooled = {
        name: {(k, "sigma"): left[kind == k] for k in np.unique(kind).tolist()}
        for name, left in residuals.items()
    }
    return covariate_of(pooled, cause, rival)


def channel_errors(
    rows: Sequence[Sequence[WhitenedRows]], sizes: Sequence[Mapping[float, Sizes]], by: str
) -> tuple[ChannelError, ...]:
    """Return root mean square errors over each horizon, before and after the ``sizes`` are removed.

    ``sizes``: for each flight, number of a segment -> sizes there, by all other parts, which are ``by``
    flight or segment.
    """
    squares: dict[tuple[str, str, float], list[Array]] = {}
    for flight, of_segment in zip(rows, sizes, strict=True):
        for averages in (r.averages for r in flight if r.averages is not None):
            for horizon in HORIZONS_S:
                found = _errors_of(averages, horizon, of_segment, by == "flight")
                squares.setdefault((averages.channel, averages.unit, horizon), []).append(found**2)
    errors = []
    for (channel, unit, horizon), of in squares.items():
        pooled = np.concatenate(of)
        if len(pooled):
            before, after = np.sqrt(pooled.mean(axis=0))
            errors.append(ChannelError(channel, unit, horizon, float(before), float(after)))
    return tuple(sorted(errors, key=lambda e: e.horizon_s))


def _errors_of(
    averages: Averages, horizon_s: float, sizes: Mapping[float, Sizes], whole_flight: bool
) -> Array:
    """Return errors (n, 2) before and after, from every moment whose horizon lies within one part."""
    ahead = round(horizon_s / NODE_S)
    last = len(averages.times_s) - ahead
    if last < 1 or ahead % averages.order:
        return np.zeros((0, 2))
    segment = averages.times_s // SEGMENT_S
    lost = np.concatenate([[0], np.cumsum(~averages.whole)])
    kept = (lost[ahead + 1 :] == lost[:last]) & (averages.pause[ahead:] == averages.pause[:last])
    kept &= whole_flight | (segment[ahead:] == segment[:last])
    kept &= np.isin(segment[:last], list(sizes))
    apart = averages.table[ahead:] - averages.table[:last]
    if averages.order == 2:
        apart -= 2.0 * (averages.table[ahead // 2 : last + ahead // 2] - averages.table[:last])
    explained = np.zeros(last)
    for number, of in sizes.items():
        own = segment[:last] == number
        for name, size in of.items():
            explained[own] += size * apart[own, averages.column(name)] if averages.knows(name) else 0.0
    return np.asarray(np.column_stack([apart[:, 0], apart[:, 0] - explained])[kept])
