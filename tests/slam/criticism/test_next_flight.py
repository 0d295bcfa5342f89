"""What the next flight should be depends on what is on board."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.criticism import next_flight
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.readings import ATTITUDE, IMU, SONAR, VELOCITY
from slam.criticism.kalman.record import record_of
from slam.criticism.next_flight import advice, telling_flight
from slam.criticism.search.effects import effects_for
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import load_model


@pytest.fixture
def few(monkeypatch):
    """Manoeuvres of which one is long."""
    allow_only(monkeypatch, ["hover for 8 s", "turn by 180 deg and hover", "square of four sides"])


def allow_only(monkeypatch, names):
    """Try these manoeuvres alone. The table itself keeps its order, from which plans are drawn."""
    few = {name: rows for name, rows in MANOEUVRES.items() if name in names}
    monkeypatch.setattr(next_flight, "MANOEUVRES", few)


def reported(kinds: set[int]) -> tuple[str, float]:
    """The manoeuvre and by how many sigmas it tells a wind from a trim."""
    model = load_model("nominal")
    record = record_of(simulate_flight(model, stick_for(["hover for 8 s"]), 1))
    known = {e.name: e for e in effects_for([record], filter_parameters_of(model))}
    said = telling_flight(model, known["steady_wind"], known["trim_offset"], np.array([0.1, 0.1]), kinds)
    name, sigma = re.search(r"fly '(.*)' .*: (.*) sigma", said).groups()
    return name, float(sigma)


def test_without_an_attitude_a_rotation_distinguishes_wind_from_trim(few):
    _, with_all = reported({IMU, ATTITUDE, VELOCITY, SONAR})
    name, with_few = reported({VELOCITY, SONAR})
    assert "turn by 180 deg" in name
    assert with_few < 0.5 * with_all


def test_a_lag_is_distinguished_from_a_latency_with_the_lag_itself_free(monkeypatch):
    """Within ±10 % of its healthy value it explains little of a latency: then the two seem far apart."""
    model, pulse = load_model("nominal"), "full stick forward for 0.5 s"
    record = record_of(simulate_flight(model, stick_for([pulse]), 1))
    allow_only(monkeypatch, [pulse])
    known = {e.name: e for e in effects_for([record], filter_parameters_of(model))}
    latency, lag = known["control_latency"], known["attitude_lag"]
    late, kinds = np.full(len(latency.columns), 0.05), {VELOCITY, SONAR}

    def sigma(said: str) -> float:
        return float(re.search(r": (.*) sigma", said)[1])

    free = sigma(telling_flight(model, latency, lag, late, kinds))
    held = sigma(telling_flight(model, latency, replace(lag, relaxes=()), late, kinds))
    assert free < 0.8 * held
    assert sigma(telling_flight(model, lag, latency, np.array([0.05]), kinds)) > 1.0


def test_the_quickest_of_the_motions_that_need_few_flights_is_advised():
    motions, took_s = ["fly 'a'", "fly 'b'", "fly 'c'"], [10.0, 10.0, 60.0]
    assert "fly 'b' once, for 10 s: 4.0 sigma" in advice("x", "y", motions, [2.0, 4.0, 9.0], took_s)
    assert "fly 'a' 3 times, each 10 s: 2.0 sigma" in advice(
        "x", "y", motions, [2.0, 1.0, 9.0], [10.0, 10.0, 90.0]
    )


def test_a_motion_that_would_be_flown_often_is_no_advice():
    said = advice("x", "y", ["fly 'a'", "fly 'b'"], [0.6, 0.2], [10.0, 10.0])
    assert said.startswith("No manoeuvre of the list distinguishes x from y in 3 flights")
    assert "The best is to fly 'a': 0.6 sigma" in said
