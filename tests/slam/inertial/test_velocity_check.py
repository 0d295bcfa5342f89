"""A velocity that the IMU contradicts is told with its likely cause; a healthy one never."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.stream_anomalies import velocity_anomalies
from slam.core.streams import VEHICLE_CLOCK_STREAMS
from slam.inertial.filter_input import filter_input
from slam.inertial.navigate import _lost_in_pauses, navigate
from slam.inertial.velocity_check import velocity_contradiction
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.slam.small_flight import flown


@pytest.fixture(scope="module")
def flight() -> Flight:
    return simulate(replace(load_recipe("square"), camera=None), seed=5)


@pytest.fixture(scope="module")
def turning() -> Flight:
    """A calm flight that turns."""
    laps = {"way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], "A"], "laps": 2, "heading": "along_path"}
    return replace(flown(0, maneuver=laps), camera=None, frames=None)


@pytest.fixture(scope="module")
def brisk() -> Flight:
    """A flight that leans to accelerate, without an IMU."""
    way = {
        "way_points": [[0, 0], [6, 0], [6, 4], [0, 4], [0, 0]],
        "cruise_m_s": 1.2,
        "acceleration_m_s2": 1.0,
    }
    made = flown(0, maneuver=way, world={"extent_m": [-1, -1, 7, 5]})
    return replace(made, camera=None, frames=None, imu=None)


def reading(flight: Flight, v_m_s: np.ndarray) -> Flight:
    return replace(flight, velocity=replace(flight.velocity, v_m_s=v_m_s))


def test_a_healthy_velocity_is_not_contradicted(flight: Flight):
    assert velocity_contradiction(flight) is None
    assert velocity_contradiction(replace(flight, attitude=None)) is None
    assert velocity_contradiction(reading(flight, 0.8 * flight.velocity.v_m_s)) is None


def test_without_an_imu_the_lean_shows_wrong_axes(brisk: Flight):
    v, angles = brisk.velocity.v_m_s, brisk.attitude.roll_pitch_yaw_rad
    assert velocity_contradiction(brisk) is None
    assert velocity_contradiction(reading(brisk, 0.7 * v)) is None
    assert "left turned round" in str(velocity_contradiction(reading(brisk, v * [1, -1])))
    assert "exchanged" in str(velocity_contradiction(reading(brisk, v[:, ::-1])))
    nose_up = replace(brisk.attitude, roll_pitch_yaw_rad=angles * [1, -1, 1])
    line = str(velocity_contradiction(replace(brisk, attitude=nose_up)))
    assert "as attitude0 shows with forward turned round" in line
    assert "signs of attitude0" in line


def test_a_lean_that_pushes_the_vehicle_nowhere_tells_nothing(brisk: Flight):
    """A car, a boat or a hand leans as it likes."""
    rng = np.random.default_rng(0)
    angles = brisk.attitude.roll_pitch_yaw_rad
    sway = np.cumsum(rng.normal(0, 0.005, (len(angles), 2)), axis=0)
    held = np.column_stack([sway - sway.mean(axis=0), angles[:, 2]])
    attitude = replace(brisk.attitude, roll_pitch_yaw_rad=held)
    assert velocity_contradiction(replace(brisk, attitude=attitude)) is None


def test_nothing_is_told_where_there_is_nothing_to_compare(flight: Flight):
    assert velocity_contradiction(replace(flight, velocity=None)) is None
    assert velocity_contradiction(replace(flight, imu=None, attitude=None)) is None
    assert velocity_contradiction(reading(flight, np.full_like(flight.velocity.v_m_s, np.nan))) is None


@pytest.mark.parametrize("with_attitude", [True, False])
def test_wrong_velocities_are_told_with_their_cause(flight: Flight, with_attitude: bool):
    flight = flight if with_attitude else replace(flight, attitude=None)
    v = flight.velocity.v_m_s
    for wrong, cause in (
        (np.tile([20.0, 0.0], (len(v), 1)), "stuck?"),
        (-v, "signs?"),
        (100 * v, "unit?"),
        (0.1 * v, "unit?"),
    ):
        assert cause in str(velocity_contradiction(reading(flight, wrong)))


def test_velocities_are_not_compared_across_a_pause(turning: Flight):
    """What changed meanwhile had been told as a constant error of the velocity."""
    assert turning.imu is not None
    middle_s = float(np.median(turning.imu.stamps_s))
    paused = turning.restamped(VEHICLE_CLOCK_STREAMS, lambda t: t + 60.0 * (t > middle_s))
    assert velocity_contradiction(paused) is None
    inputs = filter_input(paused)
    at_s = np.arange(inputs.start_s, inputs.end_s, 0.5)
    std_m = np.where(at_s > middle_s + 30, 400.0, 0.1)
    (line,) = _lost_in_pauses(inputs, at_s, std_m)
    assert re.match(r"neither IMU, velocity nor position was recorded from .* s \(±4e\+02 m\)", str(line))
    assert _lost_in_pauses(inputs, at_s, np.full(len(at_s), 0.1)) == []
    assert _lost_in_pauses(filter_input(turning), at_s, std_m) == []
    wrong = reading(paused, -turning.velocity.v_m_s)
    assert "both axes turned round" in str(velocity_contradiction(wrong))


def test_swapped_axes_are_told():
    recipe = load_recipe("square")
    brisk = replace(recipe.maneuver, cruise_m_s=1.0, acceleration_m_s2=3.0)
    flight = simulate(replace(recipe, camera=None, maneuver=brisk), seed=5)
    assert velocity_contradiction(flight) is None
    told = velocity_contradiction(reading(flight, flight.velocity.v_m_s[:, ::-1]))
    assert "with forward and left exchanged" in str(told)


@pytest.mark.parametrize("seed", [0, 1])
def test_wrong_axes_of_a_calm_flight_that_turns_are_named(seed: int):
    """Nearly half of what the accelerometer integrates is noise; other axes still fit better than chance."""
    laps = {"way_points": ["A", "B", [1.5, 0.7], [0.3, 0.7], "A"], "laps": 2, "heading": "along_path"}
    flight = flown(seed, maneuver=laps)
    flight = replace(flight, camera=None, frames=None)
    v = flight.velocity.v_m_s
    assert velocity_contradiction(flight) is None
    assert "with forward and left exchanged" in str(velocity_contradiction(reading(flight, v[:, ::-1])))
    assert "with forward turned round" in str(velocity_contradiction(reading(flight, v * [-1, 1])))
    assert "with both axes turned round" in str(velocity_contradiction(reading(flight, -v)))


@pytest.mark.parametrize("error_m_s", [(0.9, -0.9), (0.0, 1.2), (20.0, 0.0)])
@pytest.mark.parametrize("gain", [0.8, 1.0])
def test_another_zero_of_the_velocity_is_told_where_the_vehicle_turns(
    turning: Flight, error_m_s: tuple[float, float], gain: float
):
    v_m_s = gain * turning.velocity.v_m_s
    assert velocity_contradiction(reading(turning, v_m_s)) is None
    told = velocity_contradiction(reading(turning, v_m_s + error_m_s))
    found = re.search(r"error of about (\S+) m/s forward and (\S+) m/s left, as the turns", str(told))
    assert found is not None
    assert np.array(found.groups(), float) == pytest.approx(error_m_s, abs=0.15, rel=0.05)


def test_the_status_of_an_estimate_names_the_velocity(flight: Flight, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", lambda flight, *_: filter_input(flight))
    still = np.tile([20.0, 0.0], (len(flight.velocity.v_m_s), 1))
    estimate = navigate(reading(flight, still), rate_hz=2.0).estimate
    assert "velocity0 does not change while imu0 shows" in estimate.status
    assert any("reads exactly" in line for line in estimate.warnings)


def test_one_axis_that_stays_while_the_other_changes_is_told(flight: Flight):
    v = flight.velocity.v_m_s
    assert velocity_anomalies(flight.velocity) == []
    assert "left" in str(velocity_anomalies(replace(flight.velocity, v_m_s=v * [1, 0])))
    assert velocity_anomalies(replace(flight.velocity, v_m_s=0 * v)) == []
    without_left = np.column_stack([v[:, 0], np.full(len(v), np.nan)])
    assert velocity_anomalies(replace(flight.velocity, v_m_s=without_left)) == []
