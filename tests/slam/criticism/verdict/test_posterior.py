"""How probable: what makes noise larger, and what comes late and no term is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred
from slam.criticism.kalman.record import record_of
from slam.criticism.search.search import search
from slam.criticism.search.thresholds import load_thresholds
from slam.criticism.verdict.judge import left_over
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, posterior_of
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLAN = ["tilts of 15 deg to all four sides"] * 2 + ["reversing forward at 0.2"]
LATE_S = 4e-3


def judged(flights):
    """Search and posterior."""
    parameters = filter_parameters_of(at_lower_rates(load_model("nominal")))
    found = search(
        [referred(record_of(f), parameters) for f in flights], parameters, load_thresholds(pictures=False)
    )
    return found, posterior_of(found)


@pytest.mark.slow
def test_weak_gusts_are_distinguished_from_nothing_though_parameters_with_gusts_hide_them():
    model = at_lower_rates(load_model("nominal"))
    windy = model.with_term("gusts", sigma=0.07, tau=1.5)
    found, posterior = judged([simulate_flight(windy, stick_for(PLAN), seed, maker=model) for seed in (1, 2)])
    assert [e.name for e in found.chosen] == ["gusts"]
    assert posterior.probability["gusts"] > 0.99
    assert posterior.probability[NOTHING] < 1e-3
    assert [place.names for place in posterior.places] == [("gusts",)]


@pytest.mark.slow
def test_gusts_that_nothing_shows_are_not_certain_beside_a_cause_that_all_shows():
    """Evidence for gusts is computed with the latency in the parameters, not for a healthy vehicle."""
    model = at_lower_rates(load_model("nominal"))
    late = model.with_term("control_latency", T=0.1)
    found, _ = judged([simulate_flight(late, stick_for(PLAN), seed, maker=model) for seed in (1, 2)])
    assert [e.name for e in found.chosen] == ["control_latency"]
    gusts = next(e for e in found.last.effects if e.name == "gusts")
    posterior = posterior_of(replace(found, chosen=(*found.chosen, gusts)))
    assert posterior.probability["gusts"] < 0.5
    assert posterior.probability["control_latency"] > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [pytest.param(0.03, marks=pytest.mark.slow), -0.01])
def test_a_speed_that_comes_late_or_early_is_reported_as_that(late_s):
    model = at_lower_rates(load_model("nominal"))
    flights = [simulate_flight(model, stick_for(PLAN), seed) for seed in (1, 2)]
    shifted = [
        replace(f, velocity=replace(f.velocity, stamps_s=f.velocity.stamps_s + late_s)) for f in flights
    ]
    found, posterior = judged(shifted)
    assert [e.name for e in found.chosen] == ["velocity late"]
    assert posterior.probability[SOMETHING_ELSE] > 0.95
    late = left_over(found.chosen[0], found)
    assert late.channel == "velocity"
    assert late.late_s == pytest.approx(late_s, abs=3e-3)


@pytest.mark.slow
def test_an_attitude_that_comes_late_is_no_command_that_does():
    model = at_lower_rates(load_model("nominal"))
    flights = [simulate_flight(model, stick_for(PLAN), seed) for seed in (1, 2)]
    late = [replace(f, attitude=replace(f.attitude, stamps_s=f.attitude.stamps_s + LATE_S)) for f in flights]
    found, posterior = judged(late)
    assert [e.name for e in found.chosen] == ["attitude late"]
    assert posterior.probability[SOMETHING_ELSE] > 0.99
    expansion = found.last
    step, covariance = expansion.maximise(found.chosen).of(found.chosen[0].columns)
    held_s = expansion.current.get("attitude.delay_s", 0.0)
    assert step[0] + held_s == pytest.approx(LATE_S, abs=4.0 * float(np.sqrt(covariance[0, 0])) + 2e-4)
