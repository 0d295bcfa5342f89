"""Main loop of criticism: records, filter, search, explanation, verdict."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from slam.core.arguments import flight_tuple
from slam.core.duplicate_flights import without_overlaps
from slam.core.flight import Flight, with_unique_names
from slam.core.progress import Progress, show_compilation, silent
from slam.core.ranges_at_body import ranges_at_body
from slam.criticism.prepare import prepare
from slam.criticism.search.search import search
from slam.criticism.verdict.commanded_flights import explain
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.judge import judge
from slam.criticism.verdict.sentence import unusable, with_sentences
from slam.criticism.without_commands.explanation import explain_comparisons
from slam.data_quality import (
    axes_of_all,
    jumps_of_all,
    misstated_noise,
    with_scattering_noise,
    without_dead_streams,
    without_frozen,
)
from slam.data_quality.commands import has_commands
from slam.simulation.model import Model, load_model

NOTHING_TO_COMPARE = "too little of imu and attitude to compare other instruments with"
NO_LOG, WRONG_AXES = "no command log", "readings of wrong axes, which no motion of the vehicle makes"


def criticise(
    flights: Iterable[Flight], model: Model | str | Path = "nominal", progress: Progress = silent
) -> Criticism:
    """Return what a model gets wrong about flights of one vehicle.

    Raises ``InputError`` for a model that cannot be read. Flights that cannot be judged are left out and
    reported. Where none is left the verdict is ``unusable``.
    """
    from threadpoolctl import threadpool_limits

    nominal = model if isinstance(model, Model) else load_model(model)
    flights, repeated = without_overlaps(with_unique_names(flight_tuple(flights)))
    noise = tuple(misstated_noise(flights))
    flights = [with_scattering_noise(ranges_at_body(flight)) for flight in flights]
    why = NO_LOG if flights and not any(has_commands(flight) for flight in flights) else ""
    if not why and axes_of_all([without_dead_streams(flight)[0] for flight in flights])[0]:
        why = WRONG_AXES
    with threadpool_limits(1), show_compilation(progress):
        known = flights, nominal, progress
        found = _by_instruments(*known, why) if why else _with_commands(*known)
    return with_sentences(replace(found, dropped=(*map(str, repeated), *found.dropped)), noise)


def _with_commands(flights: Sequence[Flight], model: Model, progress: Progress) -> Criticism:
    """Return the verdict on flights with command logs."""
    flights, readings = without_frozen(flights)
    prepared = prepare(flights, model, progress)
    if not prepared.records:
        return unusable(prepared.dropped or ["no flights"], prepared.dropped)
    found = search(prepared.records, prepared.nominal, prepared.limits, progress)
    judged = {record.name for record in prepared.records}
    readings = [*readings, *jumps_of_all([flight for flight in flights if flight.name in judged], {})]
    return judge(explain(prepared, found, readings, model, progress))


def _by_instruments(flights: Sequence[Flight], model: Model, progress: Progress, why: str) -> Criticism:
    """Return the verdict on flights whose instruments alone are compared, for the reason ``why``."""
    clean = [without_dead_streams(flight) for flight in flights]
    dropped = [f"{flight.name}: {reason}" for flight, reasons in clean for reason in reasons]
    kept, readings = without_frozen([flight for flight, _ in clean])
    compared = explain_comparisons(kept, readings, model, why, progress)
    if compared is None:
        return unusable([f"{why}, and {NOTHING_TO_COMPARE}", *dropped], dropped)
    criticism = judge(compared)
    return replace(criticism, dropped=(*dropped, *criticism.dropped))
