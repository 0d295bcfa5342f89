"""Verdict on flights with command logs: held-out gains, causes, what is left over, and the next flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam.core.progress import Progress, Tally
from slam.criticism.cause import Cause
from slam.criticism.extended import extended_with_causes
from slam.criticism.flight_checks import untested_reasons
from slam.criticism.kalman.record import Record
from slam.criticism.next_flight import next_flight
from slam.criticism.prepare import PreparedFlights
from slam.criticism.residuals.reading_anomalies import (
    ENTAILS,
    ReadingAnomaly,
    reading_anomalies,
    smallest_in_readings,
)
from slam.criticism.search.thresholds import with_misfit
from slam.criticism.verdict.covariate import covariate
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.decision import (
    by_importance,
    causes_of,
    decide,
    errors_of,
    split_by_probability,
)
from slam.criticism.verdict.explanation import Explanation
from slam.criticism.verdict.held_out import HeldOut, held_out
from slam.criticism.verdict.power import confusable, detectable, within_reach
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.criticism.verdict.sentence import unusable, with_sentences
from slam.criticism.verdict.tables import checks, fitted_nuisances, noise_correlations, ranking
from slam.criticism.verdict.unexplained import left_over, nearest_term, untold
from slam.data_quality import StreamAnomaly
from slam.simulation.model import Model

SHOWN_PATTERNS, FEWEST_SHOWN = 8, 5
"""Number of patterns shown, and least number of effects that flights must be able to show: a tenth."""


def judge(
    prepared: PreparedFlights, explanation: Explanation, readings: Sequence[StreamAnomaly], model: Model,
    progress: Progress,
) -> Criticism:  # fmt: skip
    """Return the criticism of a model by flights with command logs and stream anomalies ``readings``."""
    found, posterior, parameters = explanation.found, explanation.posterior, explanation.parameters
    records, limits, doubts, best = found.records, prepared.limits, explanation.doubts, explanation.best
    anomalies = [*prepared.anomalies, *reading_anomalies(records, found.last.fisher.passes)]
    rolled_out = Tally(progress, "roll out", 2)
    with rolled_out.part():
        together = held_out(records, found) if any(e.is_term for e in found.chosen) else None
        errors = errors_of(found, together, best) if together else ()
        fitted = causes_of(found, posterior, together, errors, best) if together else ()
    left = sorted(found.last.score_tests(found.chosen, found.last.patterns), key=lambda s: -s.z)
    pattern_z = with_misfit(limits.patterns, max((c.z for c in fitted), default=0.0))
    left_z = max((s.z for s in left[:1] if s.z > pattern_z), default=0.0)
    likely, faint = split_by_probability(fitted, found, posterior, doubts, left_z)
    # An anomaly that cannot be removed from every stream leaves a part of its term: it is the same cause.
    likely = tuple(cause for cause in likely if cause.name not in {o.name for o in anomalies})
    causes = by_importance([*likely, *(o.cause() for o in anomalies)])
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    verdict, equivalents, remainder = decide(
        causes, found, posterior, left,
        [*untold(readings), *left_over(records, found, doubts, best, (causes, faint))], pattern_z,
        [name for o in anomalies for name in ENTAILS.get(o.name, ())],
    )  # fmt: skip
    seen = detectable(found.first, limits.effects)
    everything = seen | smallest_in_readings(records)
    if verdict == "nothing_wrong" and len(within_reach(seen)) < FEWEST_SHOWN:
        reasons = untested_reasons(records, list(within_reach(seen)))
        return replace(
            unusable(reasons, prepared.mismatched, "Fly longer, or record more."),
            detectable=seen, threshold=limits.effects, threshold_means=limits.meaning, model=model,
        )  # fmt: skip
    if verdict == "unknown" and not causes:
        remainder = "; ".join(part for part in (remainder, *nearest_term(found, limits.effects)) if part)
    with rolled_out.part():
        drawn = [covariate(records, parameters, found, c.name, c.rival, c.z) for c in causes[:1]]
    probability = posterior.probability | {c.name: c.probability for c in causes}
    criticism = Criticism(
        verdict=verdict,
        causes=causes,
        equivalence_set=equivalents,
        remainder=remainder,
        next_flight=next_flight(records, model, found, posterior, progress),
        detectable=everything,
        ranking=ranking(found, probability, [o.cause() for o in anomalies]),
        confusable=confusable(found.first),
        patterns=tuple((s.effect.name, s.z) for s in left[:SHOWN_PATTERNS]),
        nuisances=fitted_nuisances(found, best),
        noise_correlation=noise_correlations(parameters),
        checks=checks(records, found.last),
        covariate=next(iter(drawn), None),
        dropped=tuple(prepared.mismatched),
        threshold=limits.effects,
        threshold_means=limits.meaning,
        model=model,
        extended=extended_with_causes(causes, anomalies, model, parameters, records),
        unseen=_models_of_others(records, model, together, best, causes, anomalies),
    )
    return with_sentences(criticism)


def _models_of_others(
    records: Sequence[Record], model: Model, together: HeldOut | None, best: RolloutFit | None,
    causes: Sequence[Cause], anomalies: Sequence[ReadingAnomaly],
) -> dict[str, Model]:  # fmt: skip
    """Return for each flight the model fitted on all others; empty where segments of flights were held
    out."""
    if together is None or together.by != "flight":
        return {}
    after = together.after if best is None else best.left_out
    made = (extended_with_causes(causes, anomalies, model, parameters, records) for parameters in after)
    return {record.name: extended for record, extended in zip(records, made, strict=True)}
