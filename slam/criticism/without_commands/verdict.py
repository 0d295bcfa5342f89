"""Verdict on flights without a command log: the instrument errors that explain the differences between
instruments.

Each effect is a column of the whitened rows of all comparisons. The one that explains most is chosen as long
as it is significant by cluster-robust errors over segments of ten seconds, and predicts held-out parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.criticism.cause import LIKELY, Cause
from slam.criticism.extended import with_terms
from slam.criticism.search.effects import Effect
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.consistency import varying_sizes
from slam.criticism.verdict.covariate import Covariate, covariate_of
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.decision import (
    CONFIRMED_NATS,
    by_importance,
    causes_of,
    decide,
    split_by_probability,
)
from slam.criticism.verdict.held_out import held_out
from slam.criticism.verdict.posterior import Posterior, posterior_of
from slam.criticism.verdict.power import confusable, detectable
from slam.criticism.verdict.reprojection import reprojection_errors
from slam.criticism.verdict.sentence import with_sentences
from slam.criticism.verdict.tables import ranking
from slam.criticism.without_commands.likelihood import (
    likelihood_of,
    sizes_by_others,
    table_of,
)
from slam.criticism.without_commands.next_flight import next_motion
from slam.criticism.without_commands.rollouts import channel_errors
from slam.criticism.without_commands.sensor_comparison import SensorComparison, compare_sensors
from slam.criticism.without_commands.unexplained import (
    axes_of,
    left_over,
    noise_of,
    not_shown,
)
from slam.criticism.without_commands.whitened_rows import WhitenedRows
from slam.data_quality import without_frozen
from slam.simulation.model import Model

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


def criticise_without_commands(
    flights: Sequence[Flight], model: Model, dropped: Sequence[str] = (), progress: Progress = silent
) -> Criticism | None:
    """Compare the instruments with each other; None where the flights have no two that can be compared."""
    flights, readings = without_frozen(flights)
    compare = compare_sensors(flights, model, progress)
    rows = compare.rows({})
    if not any(rows):
        return None
    found, rows = _fitted(compare, rows)
    posterior = posterior_of(found)
    fitted = _causes(compare, rows, found, posterior)
    likely, faint = split_by_probability(fitted, found, posterior, ())
    anomalies = [anomaly.cause() for anomaly in compare.anomalies]
    # What a whole stream shows leads; an anomaly of single readings has no gain ahead.
    causes = tuple(sorted((*by_importance(likely), *anomalies), key=lambda c: c.probability <= LIKELY))
    wrong, unknown = axes_of(flights)
    unclear = [f"what looks like {cause.name} is something else" for cause in faint]
    remains = [*wrong, *(r.words for r in readings), *left_over(found, rows), *unclear]
    verdict, equivalents, remainder = decide(causes, found, posterior, (), remains, STANDS_OUT_Z)
    seen = detectable(found.first, STANDS_OUT_Z)
    probability = posterior.probability | {c.name: c.probability for c in causes}
    criticism = Criticism(
        verdict=verdict,
        causes=causes,
        equivalence_set=equivalents,
        remainder=remainder,
        next_flight=next_motion(model, found, rows, equivalents[:2], compare.matches, progress)
        if len(equivalents) > 1
        else "",
        detectable=seen,
        ranking=ranking(found, probability, anomalies),
        confusable=confusable(found.first),
        covariate=_covariate(rows, found, causes[0]) if causes and causes[0] in likely else None,
        threshold=STANDS_OUT_Z,
        threshold_means=STANDS_OUT,
        model=model,
        extended=with_terms(model, causes),
        flights=tuple(f.name for f, known in zip(flights, rows, strict=True) if known),
        dropped=(*dropped, *compare.dropped, REASON),
        limits=LIMITS,
    )
    more = (*noise_of(flights), *not_shown(found, rows, unknown, seen, STANDS_OUT_Z))
    return with_sentences(criticism, more)


def _fitted(
    compare: SensorComparison, rows: list[list[WhitenedRows]]
) -> tuple[SearchResult, list[list[WhitenedRows]]]:
    """Return the significant effects and the rows. Pictures are linear only near the truth, so their rows are
    computed anew about what was found."""
    found = search_linear(likelihood_of(rows, compare.parameters))
    for _ in range(ROUNDS if compare.matches is not None and found.chosen else 0):
        rows = compare.rows(found.last.quadratic.sizes(found.chosen))
        found = search_linear(likelihood_of(rows, compare.parameters))
    return found, rows


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


def _causes(
    compare: SensorComparison,
    rows: Sequence[Sequence[WhitenedRows]],
    found: SearchResult,
    posterior: Posterior,
) -> tuple[Cause, ...]:
    """Return the chosen terms as causes, with the errors without them and with the sizes that the other parts
    give."""
    if not any(e.is_term for e in found.chosen):
        return ()
    together = held_out((), found)
    errors = channel_errors(rows, sizes_by_others(found, rows), together.by)
    each = zip(np.unique(found.last.fisher.flight), together.before, together.after, strict=True)
    seen = [(known, *of) for k, *of in each if (known := compare.records[k]) is not None]
    errors += reprojection_errors(*zip(*seen, strict=True)) if seen else ()
    causes = causes_of(found, posterior, together, errors)
    return tuple(_with_varying_sizes(cause, found) for cause in causes)


def _with_varying_sizes(cause: Cause, found: SearchResult) -> Cause:
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


def _covariate(rows: Sequence[Sequence[WhitenedRows]], found: SearchResult, lead: Cause) -> Covariate | None:
    """Return the covariates of the leading cause and its rival in the differences between instruments."""
    cause, rival = lead.name, lead.rival
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
