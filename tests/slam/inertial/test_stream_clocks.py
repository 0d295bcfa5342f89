"""A clock that steps in mid-flight is set right where a gap shows it, else told; lost time is not."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from slam.core.clock_steps import clock_step_left, without_clock_steps
from slam.core.flight import Flight
from slam.inertial.filter_input import filter_input
from slam.inertial.imu_motion import ImuMotion
from slam.inertial.instrument_checks import checked
from slam.inertial.instruments import InertialTrust
from slam.inertial.navigate import navigate
from slam.inertial.stream_clocks import without_stream_steps
from tests.slam.inertial.made_navigation import made_flight, without

TRUST = InertialTrust()


def set_right(flight: Flight) -> tuple[Flight, list[str]]:
    """The flight with clocks set right, and what is told of the others."""
    motion = ImuMotion.of(flight, TRUST)
    assert motion is not None
    fixed, _, left = without_stream_steps(flight, motion, TRUST)
    return fixed, left


@pytest.fixture(scope="module")
def flight() -> Flight:
    return made_flight(1, seconds=30.0)


def _kept(flight: Flight, name: str, rows: np.ndarray, stamps_s: np.ndarray) -> Flight:
    """The flight with some rows of a stream, at new stamps."""
    series = getattr(flight, name)
    arrays = {f.name: getattr(series, f.name) for f in fields(series)}
    chosen = {
        key: value[rows]
        for key, value in arrays.items()
        if isinstance(value, np.ndarray) and len(value) == len(series.stamps_s)
    }
    return replace(flight, **{name: replace(series, **chosen | {"stamps_s": stamps_s[rows]})})


def stepped(flight: Flight, name: str, step_s: float, at_s: float = 14.0) -> Flight:
    """The flight with a clock that steps; rows are sorted by their stamps, as a reader does."""
    stamps_s = getattr(flight, name).stamps_s
    moved = np.where(stamps_s > at_s, stamps_s + step_s, stamps_s)
    return _kept(flight, name, np.argsort(moved, kind="stable"), moved)


def lost(flight: Flight, name: str, lost_s: float, at_s: float = 14.0) -> Flight:
    """The flight with a gap in which nothing was recorded."""
    stamps_s = getattr(flight, name).stamps_s
    return _kept(flight, name, np.flatnonzero((stamps_s < at_s) | (stamps_s > at_s + lost_s)), stamps_s)


@pytest.mark.parametrize("step_s", [0.1, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("name", ["imu", "attitude"])
def test_a_gyro_or_attitude_that_is_set_forward_is_set_right(flight: Flight, name: str, step_s: float):
    fixed = without_clock_steps(stepped(flight, name, step_s))
    difference_s = getattr(fixed, name).stamps_s - getattr(flight, name).stamps_s
    assert np.abs(difference_s).max() < 1e-6
    (line,) = fixed.warnings
    assert line.startswith(f"{name}0: its clock steps by {step_s:+.3f} s at 1")
    assert clock_step_left(fixed) is None


@pytest.mark.parametrize("name", ["imu", "attitude"])
def test_a_gyro_or_attitude_that_is_set_back_is_told(flight: Flight, name: str):
    moved = stepped(flight, name, -0.3)
    assert without_clock_steps(moved) is moved
    assert "the clock of attitude0 steps against that of imu0 by" in str(clock_step_left(moved))


def test_a_velocity_that_is_set_forward_is_set_right(flight: Flight):
    fixed, left = set_right(stepped(flight, "velocity", 1.0))
    assert left == []
    assert np.abs(fixed.velocity.stamps_s - flight.velocity.stamps_s).max() < 1e-6
    assert fixed.warnings[0].startswith("velocity0: its clock steps by +1.000 s at 1")


def test_an_imu_without_attitude_is_set_right_by_the_velocity(flight: Flight):
    alone = without(flight, "attitude")
    fixed, left = set_right(stepped(alone, "imu", 1.0))
    assert left == []
    assert np.abs(fixed.imu.stamps_s - flight.imu.stamps_s).max() < 1e-6


def test_a_velocity_that_is_set_back_is_told(flight: Flight):
    moved = stepped(flight, "velocity", -1.0)
    unchanged, (line,) = set_right(moved)
    assert unchanged is moved
    assert "the clock of velocity0 steps against that of imu0 by -" in str(line)


@pytest.mark.parametrize("name", ["imu", "attitude", "velocity", "sonar"])
def test_time_that_was_lost_is_no_step_of_the_clock(flight: Flight, name: str):
    gap = lost(flight, name, 1.0)
    assert without_clock_steps(gap) is gap
    assert clock_step_left(gap) is None
    same, left = set_right(gap)
    assert same is gap
    assert left == []


def test_a_healthy_flight_is_left_alone(flight: Flight):
    assert without_clock_steps(flight) is flight
    assert set_right(flight) == (flight, [])
    assert checked(flight, TRUST) == (flight, [])
    without_imu = without(flight, "imu")
    assert checked(without_imu, TRUST) == (without_imu, [])


@pytest.mark.slow
def test_the_status_of_an_estimate_names_the_step(flight: Flight, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.inertial.navigate.identify_noise", lambda flight, *_: filter_input(flight))
    assert (
        "the clock of attitude0 steps" in navigate(stepped(flight, "imu", -0.3), rate_hz=2.0).estimate.status
    )
    forward = navigate(stepped(flight, "imu", 1.0), rate_hz=2.0).estimate
    assert forward.status == "ok"
    assert any(line.startswith("imu0: its clock steps by +1.000 s") for line in forward.warnings)
