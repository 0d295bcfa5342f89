"""Corrections of the clocks: stamps as one common clock would give them."""

from __future__ import annotations

from slam.core.flight import VEHICLE_CLOCK_STREAMS, Flight
from slam.simulation.model import Model


def clock_drift(flight: Flight, model: Model) -> Flight:
    """Undo the drift of the vehicle's clock, in ppm since second 0."""
    rate = 1.0 + 1e-6 * model.value("clock_drift", "ppm")
    return flight.restamped(VEHICLE_CLOCK_STREAMS, lambda stamps_s: stamps_s / rate)


def camera_time_offset(flight: Flight, model: Model) -> Flight:
    """Undo the offset of the pictures: a picture stamped t shows the scene at t - offset."""
    offset_s = model.value("camera_time_offset", "offset")
    return flight.restamped(("frames",), lambda stamps_s: stamps_s - offset_s)


def sonar_lag(flight: Flight, model: Model) -> Flight:
    """Undo the lag of the sonar: a range stamped t was measured at t - T."""
    lag_s = model.value("sonar_lag", "T")
    return flight.restamped(("sonar",), lambda stamps_s: stamps_s - lag_s)
