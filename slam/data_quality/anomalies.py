"""Anomalies of streams: readings that freeze, cease, are rounded, or oscillate at one frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from slam.core.flight import Flight
from slam.data_quality.axes import wrong_axes
from slam.data_quality.channels import misstated_noise, streams_of
from slam.data_quality.command_clock import clock_error
from slam.data_quality.commands import log_apart
from slam.data_quality.finding import Finding, flights_to_name
from slam.data_quality.frozen import Frozen, frozen
from slam.data_quality.in_motion import others_move
from slam.data_quality.jumps import jumps
from slam.data_quality.oscillation import strongest_line
from slam.data_quality.rounding import rounding
from slam.data_quality.silent import silent


def stream_anomalies(flight: Flight) -> list[Finding]:
    """Return the anomalies of each stream of a flight."""
    streams = streams_of(flight)
    end_s = max((float(stream.stamps_s[-1]) for stream in streams if len(stream.stamps_s)), default=0.0)
    found: list[Finding | None] = []
    for stream in streams:
        moves = partial(others_move, streams, stream.name)
        found += [
            frozen(stream, moves), silent(stream, end_s, moves, flight.sonar), rounding(stream),
            strongest_line(stream),
        ]  # fmt: skip
    return [seen for seen in found if seen is not None]


def readings_in_words(flight: Flight) -> list[str]:
    """Return a line for each anomaly of a flight's streams, for readings of another axis or that jump, for
    noise that is misstated, and for commands that are on another clock."""
    apart, late, found = log_apart(flight), clock_error(flight), stream_anomalies(flight)
    return [
        *map(str, found),
        *map(str, wrong_axes(flight)[0]),
        *map(str, jumps(_without_repeated(flight, found))),
        *misstated_noise([flight]),
        *([apart] if apart else []),
        *([str(late)] if late is not None and not apart else []),
    ]


def without_frozen(flights: Sequence[Flight]) -> tuple[list[Flight], list[Finding]]:
    """Return the flights without the repeated readings of frozen instruments, and all anomalies of their
    streams."""
    clean, anomalies = [], []
    for flight, name in zip(flights, flights_to_name([f.name for f in flights]), strict=True):
        found = stream_anomalies(flight)
        clean.append(_without_repeated(flight, found))
        anomalies += [replace(anomaly, flight=name) for anomaly in found]
    return clean, anomalies


_SERIES = {
    "gyro": ("imu", "gyro_rad_s"),
    "accel": ("imu", "accel_m_s2"),
    "attitude": ("attitude", "roll_pitch_yaw_rad"),
    "velocity": ("velocity", "v_m_s"),
    "sonar": ("sonar", "range_m"),
}
"""Channel of a frozen instrument -> stream of the flight, and the field with its readings."""


def _without_repeated(flight: Flight, anomalies: Sequence[Finding]) -> Flight:
    for found in (anomaly for anomaly in anomalies if isinstance(anomaly, Frozen)):
        stream, field = _SERIES[found.channel]
        series = getattr(flight, stream)
        values = getattr(series, field).astype(float)
        values[found.repeated] = np.nan
        flight = replace(flight, **{stream: replace(series, **{field: values})})
    return flight
