"""Verdict on flights without a command log: the instrument errors that explain the differences between
instruments.

Each effect is a column of the whitened rows of all comparisons. The one that explains most is chosen as long
as it is significant by cluster-robust errors over segments of ten seconds, and predicts held-out parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.criticism.cause import LIKELY, Cause, ChannelError, Gain, Interval
from slam.criticism.extended import with_sizes
from slam.criticism.search.effects import plausible_range
from slam.criticism.search.thresholds import MISFIT
from slam.criticism.verdict.covariate import ChannelResiduals, Covariate
from slam.criticism.verdict.criticism import Criticism, Verdict
from slam.criticism.verdict.decision import CONFIRMED_NATS, is_unknown
from slam.criticism.verdict.sentence import with_sentences
from slam.criticism.verdict.tables import ranked
from slam.criticism.without_commands.consistency import varying_sizes
from slam.criticism.without_commands.next_flight import next_motion
from slam.criticism.without_commands.pictures import picture_errors
from slam.criticism.without_commands.posterior import in_place_of, posterior_of
from slam.criticism.without_commands.regression import (
    TOLERANCE,
    Regression,
    in_catalogue,
    is_square,
    part_of_segments,
    regression_of,
)
from slam.criticism.without_commands.rollouts import channel_errors
from slam.criticism.without_commands.sensor_comparison import SensorComparison, compare_sensors
from slam.criticism.without_commands.unexplained import (
    axes_of,
    in_words,
    left_over,
    noise_of,
    not_shown,
)
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.data_quality import without_frozen
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REASON = (
    "no command log: the inputs of the vehicle are not known; its instruments are compared with each other "
    "and its motion is not judged"
)
LIMITS = "No command log: the vehicle's motion is not judged."
NOTHING_TO_COMPARE = "no command log, and too little of imu and attitude to compare other instruments with"
STANDS_OUT_Z = 5.0
STANDS_OUT = (
    "set by hand where instruments are compared with each other: of 150 simulated healthy cases the greatest "
    "reaches 3.8"
)
"""``python -m slam.criticism.calibrate 150 9000 --without-commands``."""
MOST = 5
ROUNDS = 2
LARGEST_LISTED = 10.0
"""Factor on the largest value of a term: an effect that shows from there on only is not listed as
detectable."""


def criticise_without_commands(
    flights: Sequence[Flight], model: Model, dropped: Sequence[str] = (), progress: Progress = silent
) -> Criticism | None:
    """Compare the instruments with each other; None where the flights have no two that can be compared."""
    clean = [without_frozen(flight) for flight in flights]
    readings = in_words([f.name for f in flights], [words for _, words in clean])
    flights = [flight for flight, _ in clean]
    found = compare_sensors(flights, model, progress)
    rows = found.rows({})
    if not any(rows):
        return None
    data, rows, chosen = _fitted(found, rows)
    posterior = posterior_of(data, chosen)
    named = [e for e in chosen if e in CATALOGUE]
    errors = _errors(found, rows, data, chosen) if named else ()
    anomalies = [anomaly.cause() for anomaly in found.anomalies]
    causes = (*(_cause(data, chosen, e, posterior[e], errors) for e in named), *anomalies)
    causes = tuple(sorted(causes, key=lambda c: c.probability <= LIKELY))
    wrong, unknown = axes_of(flights)
    remainder = "; ".join([*wrong, *readings, *left_over(data, rows, chosen, causes)])
    verdict, equivalents = _decide(causes, posterior, remainder)
    seen = _detectable(data)
    probability = posterior | {c.name: c.probability for c in anomalies}
    shown = {e: data.z([], e) for e in data.effects() if e in CATALOGUE}
    criticism = Criticism(
        verdict=verdict,
        causes=causes,
        equivalence_set=equivalents or tuple(c.name for c in causes[:1]),
        remainder=remainder,
        next_flight=next_motion(model, rows, chosen, equivalents[:2], found.matches, progress)
        if equivalents
        else "",
        detectable=seen,
        ranking=ranked(shown, probability, anomalies),
        covariate=_covariate(data, chosen, causes[0]) if causes and causes[0].name in chosen else None,
        threshold=STANDS_OUT_Z,
        threshold_means=STANDS_OUT,
        model=model,
        extended=_extended(model, causes),
        flights=tuple(f.name for f, known in zip(flights, rows, strict=True) if known),
        dropped=(*dropped, *found.dropped, REASON),
        limits=LIMITS,
    )
    more = (*noise_of(flights), *not_shown(data, unknown, seen, STANDS_OUT_Z))
    return with_sentences(criticism, more)


def _decide(
    causes: Sequence[Cause], posterior: Mapping[str, float], remainder: str
) -> tuple[Verdict, tuple[str, ...]]:
    """Return the verdict and the equivalence set. ``causes``: the leading one first."""
    if not causes:
        return ("unknown" if remainder else "nothing_wrong"), ()
    equivalents = causes[0].alternatives if len(causes[0].alternatives) > 1 else ()
    together = sum(posterior.get(name, 0.0) for name in equivalents)
    if is_unknown(causes, posterior) and together <= LIKELY:
        return "unknown", ()
    if equivalents:
        return "ambiguous", equivalents
    return ("named_with_remainder" if remainder else "named"), ()


def _fitted(
    found: SensorComparison, rows: list[list[WhitenedRows]]
) -> tuple[Regression, list[list[WhitenedRows]], list[str]]:
    """Return the regression, its rows and the significant effects. Pictures are linear only near the truth,
    so their rows are computed anew about what was found."""
    data = regression_of(rows)
    chosen = _chosen(data)
    for _ in range(ROUNDS if found.matches is not None and chosen else 0):
        rows = found.rows(data.sizes(chosen))
        data = regression_of(rows)
        chosen = _chosen(data)
    return data, rows, chosen


def _errors(
    found: SensorComparison, rows: Sequence[Sequence[WhitenedRows]], data: Regression, chosen: Sequence[str]
) -> tuple[ChannelError, ...]:
    """Return the errors on each part, with the sizes that the other parts give to an extended model's
    terms."""
    every = data.sizes_by_others(chosen)
    sizes = {
        part: {n: x for n, x in of.items() if n.rpartition(".")[0] in CATALOGUE} for part, of in every.items()
    }
    pictures = picture_errors(found.records, found.parameters, part_of_segments(rows, data), sizes)
    return (*channel_errors(rows, data, sizes), *pictures)


def _chosen(data: Regression) -> list[str]:
    """Return the significant effects, the greatest first."""
    chosen: list[str] = []
    while len(chosen) < MOST:
        best = _next(data, chosen)
        if not best:
            break
        chosen.append(best)
    for effect in list(chosen):
        # A term that led alone may lag behind another beside the rest.
        rest = [e for e in chosen if e != effect]
        open_ = [e for e in data.effects() if e not in rest and is_plausible(data, rest, e)]
        best = max(open_, key=lambda e: data.nats([*rest, e]), default=effect)
        chosen[chosen.index(effect)] = best
    return chosen


def _next(data: Regression, chosen: Sequence[str]) -> str:
    """Return the effect that explains most beside the chosen ones, among those that stand out and predict
    held-out parts; empty where there is none."""
    open_ = [e for e in data.effects() if e not in chosen and is_plausible(data, chosen, e)]
    for effect in sorted(open_, key=lambda e: -data.nats([*chosen, e])):
        stands_out = data.z(chosen, effect) >= STANDS_OUT_Z
        if stands_out and data.held_out(chosen, effect).sum() >= CONFIRMED_NATS:
            return effect
    return ""


def _extended(model: Model, causes: Sequence[Cause]) -> Model:
    """Return the model with the causes, each within its equation's limits."""
    extended = model
    for cause in causes:
        extended = with_sizes(extended, cause.name, {n: p.value for n, p in cause.parameters.items()})
    return extended


def is_plausible(data: Regression, chosen: Sequence[str], effect: str) -> bool:
    """Whether an effect's sizes beside the chosen ones are plausible."""
    size, covariance = data.covariance([*chosen, effect])
    for k, column in zip(data.columns_of([*chosen, effect], effect), data.of(effect), strict=True):
        std = float(np.sqrt(covariance[k, k]))
        if is_square(column) and size[k] + 2 * std < 0.0:
            return False
        if effect not in CATALOGUE:
            continue
        low, high = plausible_range(effect, column.rpartition(".")[2])
        if in_catalogue(column, size[k] + 2 * std) < low or in_catalogue(column, size[k] - 2 * std) > high:
            return False
    return True


def _cause(
    data: Regression,
    chosen: Sequence[str],
    effect: str,
    probability: float,
    errors: tuple[ChannelError, ...],
) -> Cause:
    size, covariance = data.covariance(chosen, one_by_one=True)
    rest = [e for e in chosen if e != effect]
    parameters, varying = {}, varying_sizes(data, chosen, effect)
    for k, column in zip(data.columns_of(chosen, effect), data.of(effect), strict=True):
        parameter = CATALOGUE[effect].parameter(column.rpartition(".")[2])
        # The tolerance for integrals and the equation's own misfit are added to chance.
        std = float(np.hypot(np.sqrt(covariance[k, k]), TOLERANCE[effect]))
        if column in varying:
            # Another error comes and goes, so the segments are no independent measurements of one size. The
            # interval must hold the sizes of most segments, not their mean.
            std *= float(np.sqrt(len(varying[column])))
        half = float(np.hypot(data.wide * std, MISFIT * size[k]))
        value, low, high = (in_catalogue(column, float(size[k]) + x) for x in (0.0, -half, half))
        parameters[parameter.name] = Interval(value, parameter.unit, low, high)
    gain = Gain.of(data.held_out(rest, effect), data.by, errors)
    place = in_place_of(data, chosen, effect)
    z = data.z(chosen, effect)
    return Cause(
        name=effect,
        probability=probability,
        parameters=parameters,
        gain=gain,
        z=z,
        lead_nats=place.lead_nats,
        alternatives=place.names,
        rival=place.rival,
    )


def _covariate(data: Regression, chosen: Sequence[str], lead: Cause) -> Covariate:
    """Return the covariates of the leading cause and its rival in the differences between instruments."""
    cause, rival = lead.name, lead.rival
    rest = [e for e in chosen if e != cause]
    models = {"": rest, cause: [*rest, cause]} | ({rival: [*rest, rival]} if rival else {})
    residuals = {
        name: data.off - data.table(effects) @ data.fit(effects)[0] for name, effects in models.items()
    }
    against = []
    for name in [n for n in models if n]:
        explained = residuals[""] - residuals[name]
        kind = max(np.unique(data.kind), key=lambda k: float(np.sum(explained[data.kind == k] ** 2)))
        own = data.kind == kind
        against.append(
            ChannelResiduals(
                name, str(kind), "sigma", explained[own], {n: m[own] for n, m in residuals.items()}
            )
        )
    return Covariate(cause, rival, tuple(against))


def _detectable(data: Regression) -> dict[str, tuple[float, str]]:
    found = {}
    for effect in data.effects():
        if effect in CATALOGUE:
            _, covariance = data.covariance([effect])
            std = float(np.sqrt(np.diag(covariance).max() + TOLERANCE[effect] ** 2))
            size, parameter = (STANDS_OUT_Z + 1.28) * std, CATALOGUE[effect].parameters[0]
            size = float(np.sqrt(size)) if is_square(data.of(effect)[0]) else size
            if size < LARGEST_LISTED * max(abs(parameter.most), abs(parameter.least)):
                found[effect] = size, parameter.unit
    return found
