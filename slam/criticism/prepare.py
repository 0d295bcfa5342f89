"""Preparation of flights for the search: records, thresholds, filter runs, anomalous readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.core.flight import Flight
from slam.core.progress import Progress, Tally, silent
from slam.criticism.camera.reprojection import without_mismatched_pairs
from slam.criticism.cause import Cause
from slam.criticism.kalman.filter_parameters import NOISE_FIGURES, FilterParameters, filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.readings import CHANNELS, IMU, STREAMS, by_channel, channels_of
from slam.criticism.kalman.record import LONGEST_GAP_S, Record, record_of
from slam.criticism.residuals.corrected_readings import without_boxes, without_jitter
from slam.criticism.residuals.reading_anomalies import quantisation_in, without_dead_zone
from slam.criticism.search.thresholds import Thresholds, load_thresholds
from slam.data_quality.command_clock import clock_error
from slam.data_quality.commands import (
    LEAST_STICK,
    has_commands,
    has_stick_motion,
    holds_heading,
    is_aloft,
    is_calm,
    log_apart,
    readings_span_s,
    unanswered,
)
from slam.data_quality.dead_streams import without_dead_streams
from slam.data_quality.pictures.feature_matches import match_all_pictures
from slam.simulation.dynamics import COMMAND
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

SHORTEST_S = 3.0
UNSTEERED = "the stick is never moved: the model has no input"
OUT_OF_MODEL_FACTOR = 1.6
OUT_OF_MODEL_RATE_HZ = 20.0
SLOW_HZ = 10.0
"""Least rate of an instrument: a vehicle answers within a tenth of a second, which slower readings miss."""
SHOWN_BY = {
    "forward": (("pitch", "gyro_y", "velocity_x"), "attitude, gyro or speed"),
    "left": (("roll", "gyro_x", "velocity_y"), "attitude, gyro or speed"),
    "up": (("range", "accel_z"), "sonar or accelerometer"),
    "yaw": (("yaw", "gyro_z"), "attitude or gyro"),
}
"""Stick -> channels that show its effect, and their instruments in words."""
HELD_HEADING = (
    "a controller moves the turn stick and uses more than the instruments, which looks like an effect "
    "of the stick: yaw_drag is not judged, other effects must be half as large again; fly a script for more"
)


def usable_records(flights: Sequence[Flight], progress: Progress = silent) -> tuple[list[Record], list[str]]:
    """Return records of the flights that can be judged, and what was left out with the reason."""
    kept: list[Flight] = []
    records, dropped = [], []
    # A hover shows errors of the instruments and lasting effects; beside flights with stick motion it shows
    # the motion too.
    any_moved = any(has_stick_motion(flight) for flight in flights)
    for flight in flights:
        clean, reasons = without_dead_streams(flight)
        record, judged_in_part = _judged_record(clean, any_moved)
        dropped += [f"{flight.name}: {reason}" for reason in (*reasons, *judged_in_part)]
        if record is not None:
            records.append(record)
            kept.append(clean)
    matches = match_all_pictures(kept, progress)
    return [replace(r, matches=s) for r, s in zip(records, matches, strict=True)], dropped


def _judged_record(flight: Flight, any_moved: bool) -> tuple[Record | None, list[str]]:
    """Return the record of a flight, None where it cannot be judged, and what is not judged of it."""
    span_s = readings_span_s(flight)
    if span_s is None:
        return None, ["no usable imu, attitude, velocity or sonar readings are left to judge"]
    if (lasts_s := span_s[1] - span_s[0]) < SHORTEST_S:
        return None, [f"lasts {lasts_s:.1f} s; {SHORTEST_S:g} s are the least"]
    if not has_commands(flight):
        return None, ["no command log, which other flights have"]
    if reason := log_apart(flight) or unanswered(flight):
        return None, [reason]
    if not has_stick_motion(flight) and not (is_calm(flight) and (any_moved or is_aloft(flight))):
        return None, [UNSTEERED]
    try:
        record = record_of(flight)
    except ValueError as error:
        return None, [str(error)]
    notes = []
    if span_s[1] - record.duration_s > LONGEST_GAP_S:
        pause = f"no readings for {LONGEST_GAP_S:g} s or more after {record.duration_s:.1f} s"
        if record.duration_s - float(record.times_s[0]) < SHORTEST_S:
            return None, [f"{pause}, and what is before it is too short"]
        notes.append(f"{pause}: what follows is not judged")
    if (off := clock_error(flight)) is not None:
        return None, [*notes, str(off)]
    return record, [*notes, HELD_HEADING] if holds_heading(record.stick) else notes


def untested_reasons(records: Sequence[Record], shown: Sequence[str]) -> list[str]:
    """Return reasons why flights could show next to nothing but the effects ``shown``."""
    some = f"no more than {', '.join(shown)}" if shown else "none"
    reasons = [f"of {len(CATALOGUE)} effects {some} would have shown at a usual size"]
    for stick, (channels, instruments) in SHOWN_BY.items():
        moved = any((np.abs(r.stick.values[:, COMMAND.index(stick)]) >= LEAST_STICK).any() for r in records)
        if moved and not any(r.has(CHANNELS.index(c)) for r in records for c in channels):
            reasons.append(f"the {stick} stick was moved, and no {instruments} was recorded to show it")
    for kind, name in enumerate(STREAMS):
        count = sum(int(np.count_nonzero(r.kinds == kind)) for r in records)
        rate_hz = count / max(sum(r.duration_s for r in records), 1e-9)
        if 0 < rate_hz < SLOW_HZ:
            reasons.append(f"the {name} was read {rate_hz:.1f} times a second; {SLOW_HZ:g} are few")
    return reasons


def is_out_of_model(records: Sequence[Record], model: Model) -> bool:
    """Whether the noise of the instruments is far from the model's: a vehicle of another make."""
    expected, streams = _models_noise_std(model), [channels_of(k) for k in range(IMU + 1, len(STREAMS))]
    return any(
        abs(np.log(record.noise_std[c[0]] / expected[c[0]])) > np.log(OUT_OF_MODEL_FACTOR)
        for record in records for c in streams if any(map(record.has, c))
    )  # fmt: skip


def _models_noise_std(model: Model) -> Array:
    """Return (channels,) standard deviations of one reading of the model's own instruments."""
    figures = model.figures(NOISE_FIGURES)
    figures[:2] *= np.sqrt(model.imu.rate_hz)  # those of the imu are densities
    return by_channel(*figures)


def with_coarser_noise(record: Record, model: Model) -> Record:
    """Return an out-of-model vehicle's record with noise no finer than the model's own instruments at 20 Hz.

    A maker's noise figure is often the last digit of a smoothed reading. Trusted to that digit, at that rate,
    the form of one response outweighs everything that the model is for.
    """
    std = np.maximum(record.noise_std, _models_noise_std(model))
    for kind in range(len(STREAMS)):
        times_s = record.times_s[record.kinds == kind]
        if len(times_s) > 1:
            rate_hz = (len(times_s) - 1) / max(float(times_s[-1] - times_s[0]), 1e-9)
            std[list(channels_of(kind))] *= np.sqrt(max(rate_hz / OUT_OF_MODEL_RATE_HZ, 1.0))
    return replace(record, noise_std=std)


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
    anomalies: list[Cause]
    """Causes that single readings show, which were found before any filter ran."""


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
    elif any(holds_heading(record.stick) for record in records):
        limits = limits.times(CLOSED_LOOP, "a controller's sticks contain more than its instruments measure")

    def filtered(record: Record) -> tuple[Record, str]:
        return without_mismatched_pairs(referred(record, nominal), nominal)

    clean = in_threads(Tally(progress, "filter", len(records)).counting(filtered), records)
    records, mismatched = [record for record, _ in clean], [words for _, words in clean if words]
    records, late = without_jitter(records, nominal) if not nominal.out_of_model else (records, [])
    records, anomalies = without_dead_zone(records)
    anomalies = [*late, *anomalies]
    if not nominal.out_of_model and quantisation_in(records) is None:
        records, steps = without_boxes(records, nominal)
        anomalies = [*anomalies, *steps]
    return PreparedFlights(list(records), nominal, limits, (*dropped, *mismatched), anomalies)
