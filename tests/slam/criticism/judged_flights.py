"""Flights of a vehicle of the nominal kind as the search takes them."""

from __future__ import annotations

from collections.abc import Iterable

from slam.core.flight import Flight
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.record import Record, record_of
from slam.simulation.healthy.flights import at_lower_rates
from slam.simulation.model import load_model

SLOWER = at_lower_rates(load_model("nominal"))
"""The nominal vehicle, half as much work."""
NOMINAL = filter_parameters_of(SLOWER)


def judged(flights: Iterable[Flight]) -> list[Record]:
    """Their records beside a healthy run of each."""
    return [referred(record_of(flight), NOMINAL) for flight in flights]
