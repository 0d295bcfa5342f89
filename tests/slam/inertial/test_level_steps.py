"""A stream with another unit, zero or sign, be it from some time on, is told; a healthy one never."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Imu, Sonar
from slam.inertial.filter_input import filter_input
from slam.inertial.imu_motion import ImuMotion
from slam.inertial.instruments import InertialTrust
from slam.inertial.level_steps import level_contradictions
from slam.inertial.navigate import navigate
from slam.inertial.velocity_check import velocity_contradiction
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.slam.inertial.made_navigation import made_flight, without

AT_S = 12.0


def contradictions(flight: Flight) -> list[str]:
    motion = ImuMotion.of(flight, InertialTrust())
    assert motion is not None
    return list(map(str, level_contradictions(flight, motion)))


@pytest.fixture(scope="module")
def flight() -> Flight:
    return simulate(replace(load_recipe("square"), camera=None), seed=5)


def with_velocity(flight: Flight, v_m_s: np.ndarray) -> Flight:
    return replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))


def with_range(flight: Flight, range_m: np.ndarray) -> Flight:
    return replace(flight, sonar=replace(flight.sonar, range_m=range_m))


def test_a_healthy_flight_is_not_contradicted(flight: Flight):
    assert contradictions(flight) == []
    assert contradictions(without(flight, "attitude")) == []
    assert contradictions(without(flight, "sonar", "velocity")) == []


def test_a_velocity_with_another_zero_is_told_with_its_time_and_size(flight: Flight):
    late = flight.velocity.stamps_s > AT_S
    (line,) = contradictions(with_velocity(flight, flight.velocity.v_m_s + np.outer(late, [0.5, 0.0])))
    found = re.match(r"velocity0 steps by ([\d.]+) m/s at ([\d.]+) s", line)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.5, abs=0.1)
    assert float(found[2]) == pytest.approx(AT_S, abs=0.2)


def test_a_range_with_another_zero_is_told_and_an_obstacle_is_not(flight: Flight):
    stamps_s, range_m = flight.sonar.stamps_s, flight.sonar.range_m
    (line,) = contradictions(with_range(flight, range_m + 0.5 * (stamps_s > AT_S)))
    assert line.startswith("sonar0 steps by 0.")
    over = (stamps_s > AT_S) & (stamps_s < AT_S + 4.0)
    assert contradictions(with_range(flight, range_m - 0.4 * over)) == []


def test_a_range_that_sticks_in_flight_is_told(flight: Flight):
    stuck = np.where(flight.sonar.stamps_s > AT_S, 0.8, flight.sonar.range_m)
    assert any("reads exactly 0.8 m" in line for line in contradictions(with_range(flight, stuck)))


def bobbing(range_factor: float) -> Flight:
    """A level vehicle that goes up and down, with a sonar in another unit."""
    at_s, rng = np.arange(0.0, 25.0, 0.01), np.random.default_rng(0)
    height_m = 1.5 + 0.3 * np.sin(1.3 * at_s) * np.sin(0.4 * at_s)
    up_m_s2 = 9.80665 + np.gradient(np.gradient(height_m, at_s), at_s)
    accel = np.column_stack([0 * at_s, 0 * at_s, up_m_s2]) + rng.normal(0.0, 0.05, (len(at_s), 3))
    return Flight(
        name="bobbing",
        imu=Imu(at_s, rng.normal(0.0, 0.005, (len(at_s), 3)), accel, 0.0005, 0.005),
        attitude=AttitudeSeries(at_s[::4], rng.normal(0.0, 0.005, (len(at_s[::4]), 3)), (0.005,) * 3),
        sonar=Sonar(at_s[::4], range_factor * height_m[::4], 0.01, scale_std=0.0, max_range_m=10.0),
    )


def test_a_range_in_feet_is_told_where_the_height_changes():
    assert contradictions(bobbing(1.0)) == []
    assert contradictions(bobbing(1.3)) == []
    (line,) = contradictions(bobbing(3.28))
    assert line.startswith("sonar0 changes by 3.")
    assert any("sonar0 changes by -1" in line for line in contradictions(bobbing_down()))


def bobbing_down() -> Flight:
    """The same with a sonar that reads less the higher it is."""
    flight = bobbing(1.0)
    return with_range(flight, 3.0 - flight.sonar.range_m)


def test_axes_that_change_in_mid_flight_are_told():
    flight = made_flight(1, seconds=60.0)
    v, stamps_s = flight.velocity.v_m_s, flight.velocity.stamps_s
    late = (stamps_s > stamps_s[0] + 45.0)[:, None]
    line = str(velocity_contradiction(with_velocity(flight, np.where(late, -v, v))))
    assert line.startswith("from 45.0 to 60.0 s velocity0 changes as imu0 shows with both axes turned round")


@pytest.mark.slow
def test_the_status_of_an_estimate_names_the_step(flight: Flight, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", lambda flight, *_: filter_input(flight))
    late = flight.velocity.stamps_s > AT_S
    stepped = with_velocity(flight, flight.velocity.v_m_s + np.outer(late, [0.5, 0.0]))
    assert "velocity0 steps by" in navigate(stepped, rate_hz=2.0).estimate.status
    stuck = with_velocity(flight, np.where(late[:, None], [0.1, 0.3], flight.velocity.v_m_s))
    assert "velocity0: reads exactly 0.1, 0.3 m/s" in navigate(stuck, rate_hz=2.0).estimate.status
