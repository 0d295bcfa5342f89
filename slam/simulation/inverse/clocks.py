"""Stamps as one clock would have given them."""

from __future__ import annotations

from slam.core.flight import VEHICLE_CLOCK_STREAMS, Flight
from slam.simulation.model import Model


def clock_drift(flight: Flight, model: Model) -> Flight:
    """Stamps of the vehicle run fast by so many ppm since second 0."""
    rate = 1.0 + 1e-6 * model.value("clock_drift", "ppm")
    return flight.restamped(VEHICLE_CLOCK_STREAMS, lambda stamps_s: stamps_s / rate)


def camera_time_offset(flight: Flight, model: Model) -> Flight:
    """A picture stamped t shows what was at t - offset."""
    offset_s = model.value("camera_time_offset", "offset")
    return flight.restamped(("frames",), lambda stamps_s: stamps_s - offset_s)


def sonar_lag(flight: Flight, model: Model) -> Flight:
    """A range stamped t is that of t - T."""
    lag_s = model.value("sonar_lag", "T")
    return flight.restamped(("sonar",), lambda stamps_s: stamps_s - lag_s)
