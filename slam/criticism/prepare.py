"""Preparation of flights for the search: records, thresholds, filter runs, readings that are taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from slam.core.flight import Flight
from slam.core.progress import Progress, Tally
from slam.criticism.camera.mismatched_pairs import without_mismatched_pairs
from slam.criticism.flight_checks import is_out_of_model, usable_records, with_coarser_noise
from slam.criticism.kalman.filter_parameters import FilterParameters, filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.record import Record, any_holds_heading
from slam.criticism.residuals.boxes import without_boxes
from slam.criticism.residuals.reading_anomalies import ReadingAnomaly, are_quantised, without_dead_zone
from slam.criticism.residuals.stamps import without_jitter
from slam.criticism.search.thresholds import Thresholds, load_thresholds
from slam.criticism.threads import in_threads
from slam.simulation.model import Model

CLOSED_LOOP = 1.5
"""Factor on the thresholds where a controller flies: its sticks hold more than the instruments."""
OUT_OF_MODEL = 2.0
"""Factor on the thresholds of an out-of-model vehicle, whose equations are not those of the model."""


@dataclass(frozen=True)
class PreparedFlights:
    """Inputs of the search."""

    records: list[Record]
    nominal: FilterParameters
    limits: Thresholds
    dropped: tuple[str, ...]
    """Flights, streams and pictures that are not judged, with the reason, one line each."""
    anomalies: list[ReadingAnomaly]
    """Anomalies of single readings that were found before any filter ran."""


def prepare(flights: Sequence[Flight], model: Model, progress: Progress) -> PreparedFlights:
    """Return the inputs of the search from the flights that can be judged; no records where none can."""
    records, dropped = usable_records(flights, progress)
    if not records:
        return PreparedFlights([], filter_parameters_of(model), load_thresholds(), tuple(dropped), [])
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
    return PreparedFlights(list(records), nominal, limits, (*dropped, *mismatched), anomalies)


def _filtered(
    records: Sequence[Record], parameters: FilterParameters, progress: Progress
) -> tuple[list[Record], list[str]]:
    """Return the records with their runs under the healthy model, and words on pictures against these."""
    flights = Tally(progress, "filter", len(records))

    def prepared(record: Record) -> tuple[Record, str]:
        return without_mismatched_pairs(referred(record, parameters), parameters)

    found = in_threads(flights.counting(prepared), records)
    return [record for record, _ in found], [reported for _, reported in found if reported]
