"""Checks of the flights before they are judged: missing, constant or displaced streams, one line each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.progress import Progress, silent
from slam.criticism.camera.feature_matches import match_all_pictures
from slam.criticism.command_clock import clock_error
from slam.criticism.kalman.filter_parameters import NOISE_FIGURES, figure_of
from slam.criticism.kalman.readings import (
    ATTITUDE,
    CHANNELS,
    FIRST_CHANNEL,
    IMU,
    SONAR,
    VELOCITY,
    WIDTH,
    by_channel,
    channels_of,
)
from slam.criticism.kalman.record import (
    LEAST_STICK,
    LONGEST_GAP_S,
    Record,
    has_commands,
    holds_heading,
    record_of,
)
from slam.data_quality.dead_streams import FEWEST_READINGS, without_dead_streams
from slam.simulation.dynamics import COMMAND
from slam.simulation.model import Model
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

SHORTEST_S = 3.0
CALM_RAD, CALM_M_S, CALM_M = 0.1, 1.0, 0.3
"""Ranges that a hover stays within: tilt, the speed that such a tilt makes within a second, and height."""
ECHOES = 0.1
"""Share of second echoes that no sonar exceeds."""
UNSTEERED = "the stick is never moved: the model has no input"
OUT_OF_MODEL_FACTOR = 1.6
OUT_OF_MODEL_RATE_HZ = 20.0
SLOW_HZ = 10.0
"""Least rate of an instrument: a vehicle answers within a tenth of a second, so slower readings miss most of
the answer."""
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
    any_moved = any(_has_stick_motion(flight) for flight in flights)
    for flight in flights:
        clean, reasons = without_dead_streams(flight)
        dropped += [f"{flight.name}: {reason}" for reason in reasons]
        reason = _unusable(clean)
        if (
            not reason
            and not _has_stick_motion(clean)
            and not (_is_calm(clean) and (any_moved or _is_aloft(clean)))
        ):
            reason = UNSTEERED
        if reason:
            dropped.append(f"{flight.name}: {reason}")
            continue
        try:
            record = record_of(clean)
        except ValueError as error:
            dropped.append(f"{flight.name}: {error}")
            continue
        if pause := _pause(clean, record):
            if record.duration_s - float(record.times_s[0]) < SHORTEST_S:
                dropped.append(f"{flight.name}: {pause}, and what is before it is too short")
                continue
            dropped.append(f"{flight.name}: {pause}: what follows is not judged")
        if (off := clock_error(record)) is not None:
            dropped.append(f"{flight.name}: {off}")
            continue
        if holds_heading(record.stick):
            dropped.append(f"{flight.name}: {HELD_HEADING}")
        records.append(record)
        kept.append(clean)
    return [
        replace(r, matches=s) for r, s in zip(records, match_all_pictures(kept, progress), strict=True)
    ], dropped


def untested_reasons(records: Sequence[Record], shown: Sequence[str]) -> list[str]:
    """Return reasons why flights could show next to nothing. ``shown`` are the effects that they could have
    shown."""
    some = f"no more than {', '.join(shown)}" if shown else "none"
    reasons = [f"of {len(CATALOGUE)} effects {some} would have shown at a usual size"]
    for stick, (channels, instruments) in SHOWN_BY.items():
        moved = any((np.abs(r.stick.values[:, COMMAND.index(stick)]) >= LEAST_STICK).any() for r in records)
        if moved and not any(r.has(CHANNELS.index(c)) for r in records for c in channels):
            reasons.append(f"the {stick} stick was moved, and no {instruments} was recorded to show it")
    for name, kind in (("imu", IMU), ("attitude", ATTITUDE), ("velocity", VELOCITY), ("sonar", SONAR)):
        count = sum(int(np.count_nonzero(r.kinds == kind)) for r in records)
        rate_hz = count / max(sum(r.duration_s for r in records), 1e-9)
        if 0 < rate_hz < SLOW_HZ:
            reasons.append(f"the {name} was read {rate_hz:.1f} times a second; {SLOW_HZ:g} are few")
    return reasons


def is_out_of_model(records: Sequence[Record], model: Model) -> bool:
    """Whether the noise of the instruments is far from the model's: a vehicle of another make."""
    expected = _models_noise_std(model)
    for record in records:
        for kind in (ATTITUDE, VELOCITY, SONAR):
            first = FIRST_CHANNEL[kind]
            factor = abs(np.log(record.noise_std[first] / expected[first]))
            if any(record.has(c) for c in channels_of(kind)) and factor > np.log(OUT_OF_MODEL_FACTOR):
                return True
    return False


def _models_noise_std(model: Model) -> Array:
    """Return (channels,) standard deviations of one reading of the model's own instruments."""
    figures = [figure_of(model, name) for name in NOISE_FIGURES]
    # Those of the imu are densities.
    figures[:2] = [np.sqrt(model.imu.rate_hz) * density for density in figures[:2]]
    return by_channel(*figures)


def with_coarser_noise(record: Record, model: Model) -> Record:
    """Return an out-of-model vehicle's record with noise no finer than the model's own instruments at 20 Hz.

    A maker's noise figure is often the last digit of a smoothed reading. Trusted to that digit, at that rate,
    the form of one response outweighs everything that the model is for.
    """
    std = np.maximum(record.noise_std, _models_noise_std(model))
    for kind in range(len(WIDTH)):
        times_s = record.times_s[record.kinds == kind]
        if len(times_s) > 1:
            rate_hz = (len(times_s) - 1) / max(float(times_s[-1] - times_s[0]), 1e-9)
            std[list(channels_of(kind))] *= np.sqrt(max(rate_hz / OUT_OF_MODEL_RATE_HZ, 1.0))
    return replace(record, noise_std=std)


def _span_s(flight: Flight) -> tuple[float, float] | None:
    """Return the stamps of the first reading and the last; None where there are none."""
    streams = [s for s in (flight.imu, flight.attitude, flight.velocity, flight.sonar) if s is not None]
    stamps = [s.stamps_s for s in streams if len(s.stamps_s)]
    return (min(float(s[0]) for s in stamps), max(float(s[-1]) for s in stamps)) if stamps else None


def _pause(flight: Flight, record: Record) -> str:
    """Describe where a record ends before its flight; empty where it does not."""
    span_s = _span_s(flight)
    if span_s is None or span_s[1] - record.duration_s <= LONGEST_GAP_S:
        return ""
    return f"no readings for {LONGEST_GAP_S:g} s or more after {record.duration_s:.1f} s"


def _unusable(flight: Flight) -> str:
    span_s = _span_s(flight)
    if span_s is None:
        return "no imu, attitude, velocity or sonar readings to judge"
    begin, end = span_s
    if end - begin < SHORTEST_S:
        return f"lasts {end - begin:.1f} s; {SHORTEST_S:g} s are the least"
    if flight.command is None or not has_commands(flight):
        return "no command log, which other flights have"
    stamps = flight.command.stamps_s
    if stamps[0] > end or stamps[-1] < begin:
        away = stamps[0] - end if stamps[0] > end else begin - stamps[-1]
        return f"the command log is on another clock: {away:.0f} s away from the readings"
    if not ((stamps >= begin - 1.0) & (stamps <= end)).any():
        return "the command log is empty while there are readings"
    return ""


def _has_stick_motion(flight: Flight) -> bool:
    """Whether the stick moves while there are readings."""
    span_s = _span_s(flight)
    if flight.command is None or span_s is None:
        return False
    stamps = flight.command.stamps_s
    during = (stamps >= span_s[0] - 1.0) & (stamps <= span_s[1] + 1.0)
    return bool((np.abs(np.nan_to_num(flight.command.stick[during])) >= LEAST_STICK).any())


def _is_calm(flight: Flight) -> bool:
    """Whether tilt (or else speed) and height stay within the ranges of a hover. If not, the vehicle obeyed
    commands that were not logged."""
    level = [
        (flight.attitude.roll_pitch_yaw_rad[:, :2], CALM_RAD) if flight.attitude is not None else None,
        (flight.velocity.v_m_s[:, :2], CALM_M_S) if flight.velocity is not None else None,
    ]
    steady = next((known for known in level if known is not None), None)
    if steady is None or _spread(steady[0]) >= steady[1]:
        return False
    return flight.sonar is None or not _spread(flight.sonar.range_m[:, None], ECHOES) >= CALM_M


def _is_aloft(flight: Flight) -> bool:
    """Whether a sonar shows that the vehicle flies: on the floor it is too near to see."""
    return flight.sonar is not None and np.isfinite(flight.sonar.range_m).mean() > 0.5


def _spread(values: Array, tail: float = 0.01) -> float:
    """Return the greatest range over columns between the quantiles ``tail`` and 1 - ``tail``; infinite for
    too few rows."""
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < FEWEST_READINGS:
        return np.inf
    return float(np.max(np.ptp(np.quantile(values, [tail, 1.0 - tail], axis=0), axis=0)))
