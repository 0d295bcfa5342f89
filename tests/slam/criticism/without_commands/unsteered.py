"""Flights of which nobody knows the sticks, and what is found in them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from slam.criticism import criticise
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLANS = (
    ["climb and descend by 0.6 m", "three speeds forward: 0.1, 0.2, 0.4", "yaw steps at 0.3, 0.6 and 1"],
    ["brisk climb steps at full stick", "three speeds to the side: 0.1, 0.2, 0.4", "hover for 8 s"],
    ["up to 2 m, hover, and back", "reversing forward at 0.2", "yaw steps at 0.3, 0.6 and 1"],
)  # fmt: skip


def flights(term="", **size):
    return list(_flights(term, **size))


@cache
def _flights(term, **size):
    model = load_model("nominal")
    vehicle = model.with_term(term, **size) if term else model
    return [
        replace(simulate_flight(vehicle, stick_for(plan), 40 + k, maker=model), command=None)
        for k, plan in enumerate(PLANS)
    ]


@cache
def found_in(term="", **size):
    """What is found in the three flights."""
    return criticise(flights(term, **size))


def delayed(flight, by_s):
    """With an attitude that comes late, which no term is."""
    return replace(flight, attitude=replace(flight.attitude, stamps_s=flight.attitude.stamps_s + by_s))


def expansion_of(rows):
    return likelihood_of(rows, filter_parameters_of(load_model("nominal"))).last
