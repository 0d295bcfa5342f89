"""Attitude in degrees and a gyro in degrees per second are recognised by each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.turn_units import in_radians, turn_ratio
from tests.slam.small_flight import flown


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown(1)


def _attitude(flight: Flight, factor: float) -> Flight:
    angles = factor * flight.attitude.roll_pitch_yaw_rad
    return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))


def _gyro(flight: Flight, factor: float) -> Flight:
    return replace(flight, imu=replace(flight.imu, gyro_rad_s=factor * flight.imu.gyro_rad_s))


def test_attitude_in_degrees_is_used_in_radians(flight):
    found = in_radians(_attitude(flight, np.degrees(1)))
    assert found.attitude.roll_pitch_yaw_rad == pytest.approx(flight.attitude.roll_pitch_yaw_rad)
    assert "attitude0: turns 57 times as far as imu0's gyro: taken as degrees" in found.warnings[0]


def test_a_gyro_in_degrees_is_used_in_radians(flight):
    found = in_radians(_gyro(flight, np.degrees(1)))
    assert found.imu.gyro_rad_s == pytest.approx(flight.imu.gyro_rad_s)
    assert "imu0's gyro: turns 57 times as far as attitude0: taken as deg/s" in found.warnings[0]


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 30.0, 100.0])
def test_other_gains_are_no_unit(flight, factor: float):
    assert turn_ratio(_attitude(flight, factor)) == pytest.approx(factor, rel=0.15)
    for other in (_attitude(flight, factor), _gyro(flight, factor)):
        assert in_radians(other) is other


def test_an_attitude_of_noise_that_is_57_times_as_large_is_no_unit(flight):
    rng = np.random.default_rng(0)
    step = np.std(np.diff(flight.attitude.roll_pitch_yaw_rad[:, 0]))
    noise = rng.normal(0, 57 * step, flight.attitude.roll_pitch_yaw_rad.shape)
    noisy = replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=noise))
    assert in_radians(noisy) is noisy


@pytest.mark.parametrize("missing", ["imu", "attitude"])
def test_one_instrument_alone_tells_no_unit(flight, missing: str):
    alone = replace(flight, **{missing: None})
    assert in_radians(alone) is alone
