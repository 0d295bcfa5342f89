"""Only what the flights may show is looked for."""

from __future__ import annotations

import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.record import record_of
from slam.criticism.search.effects import effects_for
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

NOMINAL = load_model("nominal")


@pytest.mark.parametrize(("plan", "turns"), [("hover for 8 s", False), ("yaw steps at 0.3, 0.6 and 1", True)])
def test_the_yaw_rate_is_judged_only_for_a_vehicle_that_was_commanded_to_turn(plan, turns):
    record = record_of(simulate_flight(NOMINAL, stick_for([plan]), 1))
    names = {effect.name for effect in effects_for([record], filter_parameters_of(NOMINAL))}
    assert ("yaw_drag" in names) == turns
    assert {"gyro_bias", "steady_wind"} <= names
