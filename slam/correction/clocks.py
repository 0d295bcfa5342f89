"""Stamps as one clock would have given them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from slam.flight import Flight
from slam.simulation.model import Model

VEHICLES_CLOCK = ("imu", "attitude", "velocity", "sonar", "battery")
"""Streams that the vehicle stamps; the recorder stamps commands and pictures."""


def clock_drift(flight: Flight, model: Model) -> Flight:
    """Stamps of the vehicle run fast by so many ppm since second 0."""
    rate = 1.0 + 1e-6 * model.value("clock_drift", "ppm")
    held = {name: getattr(flight, name) for name in VEHICLES_CLOCK}
    slowed: dict[str, Any] = {
        name: replace(stream, stamps_s=stream.stamps_s / rate)
        for name, stream in held.items()
        if stream is not None
    }
    return replace(flight, **slowed)


def camera_time_offset(flight: Flight, model: Model) -> Flight:
    """A picture stamped t shows what was at t - offset."""
    assert flight.frames is not None
    offset_s = model.value("camera_time_offset", "offset")
    return replace(flight, frames=replace(flight.frames, stamps_s=flight.frames.stamps_s - offset_s))


def sonar_lag(flight: Flight, model: Model) -> Flight:
    """A range stamped t is that of t - T."""
    sonar = flight.sonar
    assert sonar is not None
    return replace(flight, sonar=replace(sonar, stamps_s=sonar.stamps_s - model.value("sonar_lag", "T")))
