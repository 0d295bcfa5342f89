"""Main loop of criticism: records, search, posterior, held-out gain, verdict."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from slam.core.arguments import flight_tuple
from slam.core.duplicate_flights import without_duplicates
from slam.core.flight import Flight, with_unique_names
from slam.core.progress import Progress, Tally, show_compilation, silent
from slam.core.ranges_at_body import ranges_at_body
from slam.criticism.camera.mismatched_pairs import without_mismatched_pairs
from slam.criticism.cause import Cause
from slam.criticism.extended import extended_with_causes, with_certainty
from slam.criticism.flight_checks import (
    is_out_of_model,
    untested_reasons,
    usable_records,
    with_coarser_noise,
)
from slam.criticism.kalman.filter_parameters import FilterParameters, filter_parameters_of
from slam.criticism.kalman.readings import INSTRUMENTS
from slam.criticism.kalman.record import Record, any_holds_heading, has_commands
from slam.criticism.kalman.reference import referred
from slam.criticism.next_flight import next_flight
from slam.criticism.residuals.boxes import without_boxes
from slam.criticism.residuals.reading_anomalies import (
    ENTAILS,
    ReadingAnomaly,
    are_quantised,
    reading_anomalies,
    smallest_in_readings,
    without_dead_zone,
)
from slam.criticism.residuals.stamps import without_jitter
from slam.criticism.search.search import SearchResult, search, with_term_replaced
from slam.criticism.search.thresholds import Thresholds, load_thresholds, with_misfit
from slam.criticism.threads import in_threads
from slam.criticism.verdict.consistency import contradictions
from slam.criticism.verdict.covariate import Covariate, covariate
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.decision import (
    by_importance,
    causes_of,
    confirmed_terms,
    decide,
    split_by_probability,
)
from slam.criticism.verdict.held_out import HeldOut, held_out, with_step
from slam.criticism.verdict.posterior import Posterior, is_term, likelier_pairs, likelier_term, posterior_of
from slam.criticism.verdict.power import confusable, detectable, within_reach
from slam.criticism.verdict.rollout_fit import RolloutFit, fit_rollouts
from slam.criticism.verdict.sentence import unusable, with_sentences
from slam.criticism.verdict.tables import checks, fitted_nuisances, ranking
from slam.criticism.verdict.unexplained import left_over, nearest_term
from slam.criticism.without_commands.verdict import NOTHING_TO_COMPARE, criticise_without_commands
from slam.data_quality import without_dead_streams
from slam.simulation.model import Model, load_model

SHOWN_PATTERNS, FEWEST_SHOWN = 8, 5
"""Number of patterns shown, and least number of effects that flights must be able to show: a tenth."""
CLOSED_LOOP = 1.5
"""Factor on the thresholds where a controller flies: its sticks contain more information than the
instruments."""
OUT_OF_MODEL = 2.0
"""Factor on the thresholds of an out-of-model vehicle, whose equations are not those of the model."""


def criticise(
    flights: Iterable[Flight], model: Model | str | Path = "nominal", progress: Progress = silent
) -> Criticism:
    """Return what a model gets wrong about flights of one vehicle.

    Raises ``InputError`` for a model that cannot be read. Flights that cannot be judged are left out and
    reported. Where none is left the verdict is ``unusable``.
    """
    from threadpoolctl import threadpool_limits

    nominal = model if isinstance(model, Model) else load_model(model)
    flights, repeated = without_duplicates(with_unique_names(flight_tuple(flights)))
    flights = [ranges_at_body(flight) for flight in flights]
    with_commands = not flights or any(has_commands(flight) for flight in flights)
    with threadpool_limits(1), show_compilation(progress):
        found = (_with_commands if with_commands else _without_commands)(flights, nominal, progress)
    found = replace(found, dropped=(*repeated, *found.dropped))
    if found.extended is None:
        return found
    return replace(found, extended=with_certainty(found.extended, found.causes))


def _with_commands(flights: Sequence[Flight], model: Model, progress: Progress) -> Criticism:
    """Return the verdict on flights with command logs."""
    records, dropped = usable_records(flights, progress)
    names = tuple(record.name for record in records)
    if not records:
        return unusable(dropped or ["no flights"], dropped)
    found = _judged(records, model, progress)
    return replace(found, flights=names, dropped=(*dropped, *found.dropped))


def _without_commands(flights: Sequence[Flight], model: Model, progress: Progress) -> Criticism:
    """Return the verdict on flights without command logs."""
    clean = [without_dead_streams(flight) for flight in flights]
    dropped = [f"{flight.name}: {reason}" for flight, reasons in clean for reason in reasons]
    found = criticise_without_commands([flight for flight, _ in clean], model, dropped, progress)
    if found is None:
        return unusable([NOTHING_TO_COMPARE, *dropped], dropped)
    return found


@dataclass(frozen=True)
class _Prepared:
    """Inputs of the search."""

    records: list[Record]
    nominal: FilterParameters
    limits: Thresholds
    mismatched: list[str]
    """Descriptions of the pictures that were left out."""
    anomalies: list[ReadingAnomaly]
    """Anomalies of single readings that were found before any filter ran."""


@dataclass(frozen=True)
class _Explained:
    """Result of the search."""

    found: SearchResult
    parameters: FilterParameters
    """Filter parameters with the chosen causes in them."""
    posterior: Posterior
    doubts: dict[str, str]
    """Cause -> description of what contradicts it."""
    best: RolloutFit | None
    """Sizes by roll-outs for an out-of-model vehicle, else None."""


def _prepared(records: Sequence[Record], model: Model, progress: Progress) -> _Prepared:
    limits = load_thresholds(pictures=any(record.matches is not None for record in records))
    nominal = replace(filter_parameters_of(model), out_of_model=is_out_of_model(records, model))
    if nominal.out_of_model:
        records = [with_coarser_noise(record, model) for record in records]
        limits = limits.times(OUT_OF_MODEL, "the vehicle is not of the model's kind")
    elif any_holds_heading(records):
        limits = limits.times(CLOSED_LOOP, "a controller's sticks contain more than its instruments measure")
    records, mismatched = _filtered(records, nominal, progress)
    records, late = without_jitter(records, nominal) if not nominal.out_of_model else (records, [])
    records, anomalies = without_dead_zone(records)
    anomalies = [*late, *anomalies]
    if not nominal.out_of_model and not are_quantised(records):
        records, steps = without_boxes(records, nominal)
        anomalies = [*anomalies, *steps]
    return _Prepared(list(records), nominal, limits, mismatched, anomalies)


def _explained(prepared: _Prepared, progress: Progress) -> _Explained:
    nominal = prepared.nominal
    found = search(prepared.records, nominal, prepared.limits, progress)
    records = found.records
    found = confirmed_terms(records, found, nominal)
    posterior = posterior_of(found)
    likeliest = _likeliest(records, found, posterior)
    parameters = _fitted_parameters(likeliest)
    doubts, refuted = contradictions(records, nominal, likeliest, parameters)
    reported = likeliest
    if refuted:
        reported = replace(reported, chosen=tuple(e for e in reported.chosen if e.name not in refuted))
        parameters = _fitted_parameters(reported)
    best = None
    if nominal.out_of_model and reported.chosen and len(records) > 1:
        best = fit_rollouts(records, parameters, reported.first.parameters, reported, progress)
        reported, parameters = replace(reported, chosen=best.chosen), best.parameters
    return _Explained(
        reported, parameters, posterior if reported is found else posterior_of(reported), doubts, best
    )


def _judged(records: Sequence[Record], model: Model, progress: Progress) -> Criticism:
    prepared = _prepared(records, model, progress)
    explained = _explained(prepared, progress)
    records, limits = explained.found.records, prepared.limits
    found, parameters, doubts, best = explained.found, explained.parameters, explained.doubts, explained.best
    posterior = explained.posterior
    anomalies = [*prepared.anomalies, *reading_anomalies(records, found.last.fisher.passes)]
    rolled_out = Tally(progress, "roll out", 2)
    with rolled_out.part():
        together = held_out(records, found, prepared.nominal) if any(map(is_term, found.chosen)) else None
        fitted = causes_of(records, prepared.nominal, found, posterior, together, best) if together else ()
    left = sorted(found.last.score_tests(found.chosen, found.last.patterns), key=lambda s: -s.z)
    pattern_z = with_misfit(limits.patterns, max((c.z for c in fitted), default=0.0))
    left_z = max((s.z for s in left[:1] if s.z > pattern_z), default=0.0)
    likely, faint = split_by_probability(fitted, found, posterior, doubts, left_z)
    # An anomaly that cannot be removed from every stream leaves a part of its term: it is the same cause.
    likely = tuple(cause for cause in likely if cause.name not in {o.name for o in anomalies})
    causes = by_importance([*likely, *(o.cause() for o in anomalies)])
    pattern_z = with_misfit(limits.patterns, max((c.z for c in causes), default=0.0))
    verdict, equivalents, remainder = decide(
        causes, found, posterior, left, left_over(records, found, doubts, best, (causes, faint)), pattern_z,
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
        drawn = _covariate(records, parameters, found, causes)
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
        noise_correlation=_noise_correlations(parameters),
        checks=checks(records, found.last),
        covariate=drawn,
        dropped=tuple(prepared.mismatched),
        threshold=limits.effects,
        threshold_means=limits.meaning,
        model=model,
        extended=extended_with_causes(causes, anomalies, model, parameters, records),
        unseen={}
        if together is None
        else _models_of_others(records, model, together, best, causes, anomalies),
    )
    return with_sentences(criticism)


def _noise_correlations(parameters: FilterParameters) -> dict[str, float]:
    """Return the correlation of successive readings of each instrument that has one."""
    each = zip(INSTRUMENTS, parameters.noise_correlation.tolist(), strict=True)
    return {instrument: correlation for instrument, correlation in each if correlation > 0.0}


def _covariate(
    records: Sequence[Record], parameters: FilterParameters, found: SearchResult, causes: Sequence[Cause]
) -> Covariate | None:
    """Return the covariates of the leading cause and its rival."""
    if not causes:
        return None
    return covariate(records, parameters, found, causes[0].name, causes[0].rival, causes[0].z)


def _filtered(
    records: Sequence[Record], parameters: FilterParameters, progress: Progress
) -> tuple[list[Record], list[str]]:
    """Return the records with their reference runs under the healthy model, and descriptions of the pictures
    that contradict these runs."""
    flights = Tally(progress, "filter", len(records))

    def prepared(record: Record) -> tuple[Record, str]:
        return without_mismatched_pairs(referred(record, parameters), parameters)

    found = in_threads(flights.counting(prepared), records)
    return [record for record, _ in found], [reported for _, reported in found if reported]


def _likeliest(records: Sequence[Record], found: SearchResult, posterior: Posterior) -> SearchResult:
    """Replace chosen terms by more probable ones, each by another term or by two, and return the search
    result."""
    other = likelier_term(found, posterior)
    if other is not None:
        place, name = other
        found = with_term_replaced(
            records, found, place, [(e,) for e in found.last.effects if e.name == name]
        )
    for place in found.chosen:
        if pairs := likelier_pairs(found, place):
            found = with_term_replaced(records, found, place, pairs)
        if place not in found.chosen:
            break
    return found


def _fitted_parameters(found: SearchResult) -> FilterParameters:
    return with_step(found.last, found.last.quadratic.maximise(found.chosen).whole, found.chosen)


def _models_of_others(
    records: Sequence[Record], model: Model, together: HeldOut, best: RolloutFit | None,
    causes: Sequence[Cause], anomalies: Sequence[ReadingAnomaly],
) -> dict[str, Model]:  # fmt: skip
    """Return for each flight the model fitted on all others; empty where segments of flights were held
    out."""
    if together.by != "flight":
        return {}
    after = together.after if best is None else best.left_out
    made = (extended_with_causes(causes, anomalies, model, parameters, records) for parameters in after)
    return {record.name: extended for record, extended in zip(records, made, strict=True)}
