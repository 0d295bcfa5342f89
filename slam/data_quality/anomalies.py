"""Anomalies of whole streams: readings that freeze, that are rounded, or that oscillate at one frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from slam.core.flight import Flight
from slam.data_quality.axes import wrong_axes
from slam.data_quality.channels import misstated_noise, streams_of
from slam.data_quality.command_clock import clock_error
from slam.data_quality.commands import log_apart
from slam.data_quality.finding import Finding, flights_to_name
from slam.data_quality.frozen import Frozen, frozen
from slam.data_quality.jumps import jumps
from slam.data_quality.oscillation import strongest_line
from slam.data_quality.rounding import rounding


def stream_anomalies(flight: Flight) -> list[Finding]:
    """Return the anomalies of each stream of a flight."""
    looks = (frozen, rounding, strongest_line)
    each = (look(stream) for stream in streams_of(flight) for look in looks)
    return [seen for seen in each if seen is not None]


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
    """Return the flights without repeated ranges, speeds and attitudes of frozen instruments, and all
    anomalies of their streams."""
    clean, anomalies = [], []
    for flight, name in zip(flights, flights_to_name([f.name for f in flights]), strict=True):
        found = stream_anomalies(flight)
        clean.append(_without_repeated(flight, found))
        anomalies += [replace(anomaly, flight=name) for anomaly in found]
    return clean, anomalies


def _without_repeated(flight: Flight, anomalies: Sequence[Finding]) -> Flight:
    repeated = {found.channel: found.repeated for found in anomalies if isinstance(found, Frozen)}
    if flight.sonar is not None and "sonar" in repeated:
        range_m = np.where(repeated["sonar"], np.nan, flight.sonar.range_m)
        flight = replace(flight, sonar=replace(flight.sonar, range_m=range_m))
    if flight.velocity is not None and "velocity" in repeated:
        v_m_s = np.where(repeated["velocity"][:, None], np.nan, flight.velocity.v_m_s)
        flight = replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))
    if flight.attitude is not None and "attitude" in repeated:
        angles_rad = np.where(repeated["attitude"][:, None], np.nan, flight.attitude.roll_pitch_yaw_rad)
        flight = replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles_rad))
    return flight
