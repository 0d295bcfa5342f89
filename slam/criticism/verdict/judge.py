"""Verdict on flights with and without command logs: causes, what is left over, and the next flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam.core.flight import Flight
from slam.core.progress import Progress, Tally
from slam.criticism.camera.reprojection import reprojection_errors
from slam.criticism.cause import Cause
from slam.criticism.extended import extended_with_causes, with_certainty, with_terms
from slam.criticism.flight_checks import untested_reasons
from slam.criticism.kalman.record import Record
from slam.criticism.next_flight import next_flight, next_motion
from slam.criticism.prepare import PreparedFlights
from slam.criticism.residuals.reading_anomalies import (
    ENTAILS,
    ReadingAnomaly,
    reading_anomalies,
    smallest_in_readings,
)
from slam.criticism.search.expansion import ScoreTest
from slam.criticism.search.thresholds import Thresholds, with_misfit
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
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.criticism.verdict.sentence import unusable, with_sentences
from slam.criticism.verdict.tables import (
    checks,
    confusable,
    detectable,
    fitted_nuisances,
    noise_correlations,
    ranking,
    within_reach,
)
from slam.criticism.verdict.unexplained import (
    axes_of,
    left_over,
    left_over_in_comparisons,
    nearest_term,
    noise_of,
    not_shown,
    untold,
)
from slam.criticism.without_commands.explanation import (
    LIMITS,
    ComparedFlights,
    channel_errors,
    covariate_in_comparisons,
    with_varying_sizes,
)
from slam.criticism.without_commands.likelihood import sizes_by_others
from slam.data_quality import StreamAnomaly
from slam.simulation.model import Model

SHOWN_PATTERNS, FEWEST_SHOWN = 8, 5
"""Number of patterns shown, and least number of effects that flights must be able to show: a tenth."""
NO_COMMANDS = (
    "no command log: the inputs of the vehicle are not known; its instruments are compared with each other "
    "and its motion is not judged"
)
NOT_JUDGED = "No command log: the vehicle's motion is not judged."


def judge(
    prepared: PreparedFlights, explanation: Explanation, readings: Sequence[StreamAnomaly], model: Model,
    progress: Progress,
) -> Criticism:  # fmt: skip
    """Return the criticism of a model by flights with command logs and stream anomalies ``readings``."""
    found, posterior, parameters = explanation.found, explanation.posterior, explanation.parameters
    records, limits, doubts, best = found.records, prepared.limits, explanation.doubts, explanation.best
    names = tuple(record.name for record in records)
    anomalies = [*prepared.anomalies, *reading_anomalies(records, found.last.fisher.passes)]
    rolled_out = Tally(progress, "roll out", 2)
    with rolled_out.part():
        together = held_out(records, found) if any(e.is_term for e in found.chosen) else None
        errors = errors_of(found, together, best) if together else ()
        fitted = causes_of(found, posterior, together, errors, best) if together else ()
    judged = _judged(explanation, fitted, anomalies, limits)
    unexplained = [*untold(readings), *left_over(records, found, doubts, best, judged[:2])]
    criticism = _concluded(explanation, judged, anomalies, unexplained, limits, model)
    seen, causes = criticism.detectable, judged.causes
    if criticism.verdict == "nothing_wrong" and len(within_reach(seen)) < FEWEST_SHOWN:
        reasons = untested_reasons(records, list(within_reach(seen)))
        return replace(
            unusable(reasons, prepared.dropped, "Fly longer, or record more."),
            flights=names, detectable=seen, threshold=limits.effects, threshold_means=limits.meaning,
            model=model,
        )  # fmt: skip
    remainder = [criticism.remainder]
    if criticism.verdict == "unknown" and not causes:
        remainder += nearest_term(found, limits.effects)
    with rolled_out.part():
        drawn = [covariate(records, parameters, found, c.name, c.rival, c.z) for c in causes[:1]]
    return with_sentences(
        replace(
            criticism,
            remainder="; ".join(part for part in remainder if part),
            next_flight=next_flight(records, model, found, posterior, progress),
            detectable=seen | smallest_in_readings(records),
            nuisances=fitted_nuisances(found, best),
            noise_correlation=noise_correlations(parameters),
            checks=checks(records, found.last),
            covariate=next(iter(drawn), None),
            flights=names,
            dropped=prepared.dropped,
            extended=with_certainty(
                extended_with_causes(causes, anomalies, model, parameters, records), causes
            ),
            unseen=_models_of_others(records, model, together, best, causes, anomalies),
        )
    )


def judge_comparisons(
    flights: Sequence[Flight], compared: ComparedFlights, explanation: Explanation,
    readings: Sequence[StreamAnomaly], model: Model, progress: Progress,
) -> Criticism:  # fmt: skip
    """Return the criticism of a model by flights without command logs, whose instruments were compared with
    each other."""
    found, rows, sensors = explanation.found, compared.rows, compared.sensors
    judged = _judged(explanation, _compared_causes(compared, explanation), sensors.anomalies, LIMITS)
    wrong, unknown = axes_of(flights)
    unclear = [f"what looks like {cause.name} is something else" for cause in judged.faint]
    unexplained = [*wrong, *(r.words for r in readings), *left_over_in_comparisons(found, rows), *unclear]
    criticism = _concluded(explanation, judged, sensors.anomalies, unexplained, LIMITS, model)
    rivals = criticism.equivalence_set[:2]
    advised = next_motion(model, found, rows, rivals, sensors.matches, progress) if rivals[1:] else ""
    more = (*noise_of(flights), *not_shown(found, rows, unknown, criticism.detectable, LIMITS.effects))
    return with_sentences(
        replace(
            criticism,
            next_flight=advised,
            covariate=next((covariate_in_comparisons(rows, found, c) for c in judged.causes[:1]), None),
            extended=with_certainty(with_terms(model, judged.causes), judged.causes),
            flights=tuple(f.name for f, known in zip(flights, rows, strict=True) if known),
            dropped=(*sensors.dropped, NO_COMMANDS),
            limits=NOT_JUDGED,
        ),
        more,
    )


class _Judged(NamedTuple):
    """Causes by their probability, and the residual patterns beside them."""

    causes: tuple[Cause, ...]
    """Those that are reported, the leading one first."""
    faint: tuple[Cause, ...]
    left: list[ScoreTest]
    """Residual patterns, greatest first."""


def _judged(
    explanation: Explanation, fitted: Sequence[Cause], anomalies: Sequence[ReadingAnomaly], limits: Thresholds
) -> _Judged:
    """Divide the chosen terms ``fitted`` by their probability, and add the anomalies of single readings."""
    found = explanation.found
    left = sorted(found.last.score_tests(found.chosen, found.last.patterns), key=lambda s: -s.z)
    pattern_z = with_misfit(limits.patterns, max((c.z for c in fitted), default=0.0))
    left_z = max((s.z for s in left[:1] if s.z > pattern_z), default=0.0)
    likely, faint = split_by_probability(fitted, found, explanation.posterior, explanation.doubts, left_z)
    # An anomaly that cannot be removed from every stream leaves a part of its term: it is the same cause.
    likely = tuple(cause for cause in likely if cause.name not in {o.name for o in anomalies})
    return _Judged(by_importance([*likely, *(o.cause() for o in anomalies)]), faint, left)


def _concluded(
    explanation: Explanation, judged: _Judged, anomalies: Sequence[ReadingAnomaly],
    unexplained: Sequence[str], limits: Thresholds, model: Model,
) -> Criticism:  # fmt: skip
    """Return the verdict, without its sentences, from the ``unexplained`` findings beside the causes."""
    found, posterior, (causes, _, left) = explanation.found, explanation.posterior, judged
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    entailed = [name for o in anomalies for name in ENTAILS.get(o.name, ())]
    verdict, equivalents, remainder = decide(causes, found, posterior, left, unexplained, pattern_z, entailed)
    probability = posterior.probability | {c.name: c.probability for c in causes}
    return Criticism(
        verdict=verdict,
        causes=causes,
        equivalence_set=equivalents,
        remainder=remainder,
        detectable=detectable(found.first, limits.effects),
        ranking=ranking(found, probability, [o.cause() for o in anomalies]),
        confusable=confusable(found.first),
        patterns=tuple((s.effect.name, s.z) for s in left[:SHOWN_PATTERNS]),
        threshold=limits.effects,
        threshold_means=limits.meaning,
        model=model,
    )


def _compared_causes(compared: ComparedFlights, explanation: Explanation) -> tuple[Cause, ...]:
    """Return the chosen terms as causes, with the errors without them and with the sizes that the other parts
    give."""
    found, rows = explanation.found, compared.rows
    if not any(e.is_term for e in found.chosen):
        return ()
    together = held_out((), found)
    errors = channel_errors(rows, sizes_by_others(found, rows), together.by)
    each = zip(np.unique(found.last.fisher.flight), together.before, together.after, strict=True)
    seen = [(known, *of) for k, *of in each if (known := compared.sensors.records[k]) is not None]
    errors += reprojection_errors(*zip(*seen, strict=True)) if seen else ()
    causes = causes_of(found, explanation.posterior, together, errors)
    return tuple(with_varying_sizes(cause, found) for cause in causes)


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
