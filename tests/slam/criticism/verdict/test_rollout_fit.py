"""Sizes that fly best: roll-outs of flights whose vehicle is known find its sizes, from far off."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.core.progress import Tally, silent
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.prepare import usable_records
from slam.criticism.search.effects import effects_for
from slam.criticism.search.expansion import ScoreTest
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.verdict.rollout_fit import _extended, _Fit, _instead, _out_of_range, _Rollouts
from slam.simulation.dynamics import ATTITUDE_TIME
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLAN = ["three speeds forward: 0.1, 0.2, 0.4", "three speeds to the side: 0.1, 0.2, 0.4"]
LEAN = 0.8


def rollouts_of(records, nominal):
    first = SimpleNamespace(parameters=nominal)
    return _Rollouts(SimpleNamespace(records=records, model=nominal, first=first), nominal, silent)


@pytest.fixture(scope="module")
def braking():
    """Three flights of a vehicle that leans against its speed, and the nominal parameters."""
    slower = at_lower_rates(load_model("nominal"))
    vehicle = slower.with_term("active_braking", lean=LEAN)
    vehicle = replace(vehicle, vehicle=replace(vehicle.vehicle, attitude_time_s=0.2))
    flights = [simulate_flight(vehicle, stick_for(PLAN), seed, maker=slower) for seed in (1, 2, 3)]
    records, dropped = usable_records(flights)
    assert not dropped
    return records, filter_parameters_of(slower)


def lean_of(records, parameters):
    return next(
        e for e in effects_for(records, parameters)
        if e.name == "active_braking" and e.parameters == ("lean",)
    )  # fmt: skip


@pytest.mark.slow
def test_sizes_are_found_from_far_off_and_left_out_flights_say_how_well(braking):
    records, nominal = braking
    course = rollouts_of(records, nominal)
    lean = lean_of(records, nominal)
    with_it, without = (course.fitted(nominal, effects) for effects in ([lean], []))
    found = dict(zip(with_it.columns, with_it.steps.T, strict=True))
    size = with_it.parameters.dynamics[lean.perturbations[0].entry]
    tau = with_it.parameters.dynamics[ATTITUDE_TIME]
    assert size == pytest.approx(LEAN, rel=0.15)
    assert tau == pytest.approx(0.2, rel=0.15)
    assert 0.0 < np.abs(found[lean.columns[0]]).max() < 0.3 * LEAN
    # Every flight is predicted better from the others with it than without.
    assert (with_it.residuals.sum(axis=1) < 0.75 * without.residuals.sum(axis=1)).all()
    assert with_it.better_than(without)
    assert not without.better_than(with_it)


def test_a_constant_far_from_healthy_is_reported_and_no_reason_to_drop_a_term(braking):
    _, nominal = braking
    empty = np.zeros((1, 1))
    healthy, bent = (
        _Fit(parameters, ("vehicle.gain",), (), empty, empty)
        for parameters in (nominal, fitted_parameter("vehicle.gain").stepped(nominal, -0.58))
    )
    assert [n.name for n in _instead(healthy, bent, nominal)] == ["vehicle.gain"]
    assert _instead(bent, bent, nominal) == _instead(healthy, healthy, nominal) == []
    (gain,) = _instead(healthy, bent, nominal)
    assert gain.is_beyond(bent.parameters, nominal, 0.1)
    assert not gain.is_beyond(bent.parameters, nominal, 0.5)
    assert (
        str(_out_of_range(gain, bent.parameters, nominal)) == "vehicle.gain is 0.42 (healthy: 0.95 to 1.05)"
    )


@pytest.mark.slow
def test_what_is_not_there_has_no_size(braking):
    records, nominal = braking
    course = rollouts_of(records, nominal)
    lean = lean_of(records, nominal)
    drag = next(e for e in effects_for(records, nominal) if e.name == "quadratic_drag")
    both, one = course.fitted(nominal, [lean, drag]), course.fitted(nominal, [lean])
    assert not both.better_than(one)


def test_of_what_no_chance_makes_flights_say_whether_it_enters(braking):
    records, nominal = braking
    every = effects_for(records, nominal)
    asked = {e.name: e for e in every if e.name in ("quadratic_drag", "battery_sag")}
    asked["active_braking"] = lean_of(records, nominal)
    helps = {"active_braking": 0.5, "battery_sag": 0.2}

    def fitted(_, effects):
        residuals = 1.0 - sum(helps.get(e.name, 0.0) for e in effects)
        return SimpleNamespace(
            parameters=nominal, residuals=residuals, better_than=lambda o: residuals < o.residuals
        )

    def enters(independent):
        def nats(fit, other):
            return np.array([independent * (other.residuals - fit.residuals)])

        course = SimpleNamespace(fitted=fitted, nats=nats)
        chosen, fit = _extended(course, found, fitted(nominal, []))
        assert fit.residuals == fitted(nominal, chosen).residuals
        return [e.name for e in chosen]

    z = {"quadratic_drag": 9.0, "active_braking": 4.2, "battery_sag": 3.0}
    standing = [ScoreTest(asked[name], 0.5 * z[name] ** 2, z[name]) for name in z]
    expansion = SimpleNamespace(effects=every, score_tests=lambda *_: standing)
    found = SimpleNamespace(chosen=(), last=expansion)
    assert enters(50.0) == ["active_braking"]
    # Of what is asked for so little flights must be sure.
    assert enters(5.0) == []


class Rough(_Rollouts):
    """Misses that grow with how far a delay is from 80 ms, and jump where commands move across readings."""

    def __init__(self, records, model):
        self._records, self._model, self._rounds = records, model, Tally(silent, "fit roll-outs")

    def _by_channel(self, flight, parameters):
        off_s = parameters.latency_s - 0.08
        return [np.array([10.0 * off_s + 0.02 * np.sin(2.0 * np.pi * off_s / 0.006)])]


@pytest.mark.parametrize("start_s", [0.03, 0.05, 0.062, 0.11, 0.13])
def test_a_delay_is_found_though_misses_are_rough(braking, start_s):
    records, nominal = braking
    latency = next(e for e in effects_for(records, nominal) if e.name == "control_latency")
    start = replace(nominal, latency_s=start_s)
    fit = Rough(records, nominal).fitted(start, [latency.free])
    assert fit.parameters.latency_s == pytest.approx(0.08, abs=0.006)
