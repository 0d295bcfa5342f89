"""A line about a flight or a map says what to do: a pilot has nothing but the page."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.core.flight_info import describe
from slam.core.lost_pictures import SHOW_NOTHING
from slam.core.missing_streams import missing_for_map
from slam.mapping.calibration.attitude_floor_tilt import AttitudeFloorTilt, attitude_floor_tilt_warning
from slam.mapping.warnings.lost_pictures import _HINTS
from tests.slam.io.made_flight import made_flight

ACTION = re.compile(r"[;:] (calibrate|check|correct|fly|leave|record|repair|the map estimates)\b")
"""Begin of a clause that says what to do, or that nothing is to be done."""
LIVE = 1.0 + np.random.default_rng(0).normal(0, 0.01, 500)


def ranged(range_m: np.ndarray):
    flight = made_flight()
    stamps_s = 0.04 * np.arange(len(range_m))
    return replace(flight, sonar=replace(flight.sonar, stamps_s=stamps_s, range_m=range_m))


def angled(axis: int, value_rad: float):
    flight = made_flight()
    angles = flight.attitude.roll_pitch_yaw_rad.copy()
    angles[:, axis] = value_rad
    return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))


def resting(gyro_rad_s: float, accel: float):
    flight = made_flight()
    shape = flight.imu.gyro_rad_s.shape
    noise = np.random.default_rng(1).normal(0, 1e-3, shape)
    imu = replace(flight.imu, gyro_rad_s=gyro_rad_s + noise, accel_m_s2=accel * flight.imu.accel_m_s2)
    return replace(flight, imu=imu)


ODD = {
    "no range": lambda: ranged(np.full(50, np.nan)),
    "negative": lambda: ranged(np.r_[LIVE, -1.0, 0.0]),
    "saturated": lambda: ranged(np.r_[LIVE, np.full(60, 6.0)]),
    "below": lambda: ranged(np.r_[LIVE, np.full(60, 0.1)]),
    "stuck": lambda: ranged(np.r_[LIVE, np.full(200, 1.5)]),
    "echoes": lambda: ranged(np.where(np.arange(500) % 7 == 3, 2.0, LIVE)),
    "roll missing": lambda: angled(0, np.nan),
    "yaw unwrapped": lambda: angled(2, 7.0),
    "pitch steep": lambda: angled(1, 1.2),
    "gyro at rest": lambda: resting(0.1, 1.0),
    "gravity": lambda: resting(0.0, 0.9),
}


@pytest.mark.parametrize("name", ODD)
def test_an_anomaly_of_a_stream_says_what_to_do(name):
    usual = set(describe(made_flight()).anomalies)
    lines = [line for line in describe(ODD[name]()).anomalies if line not in usual]
    assert lines
    assert [line for line in lines if not ACTION.search(line)] == []


def test_what_is_missing_says_what_to_record():
    bare = replace(made_flight(), imu=None, attitude=None, sonar=None, gps=None)
    lines = tuple(map(str, missing_for_map(bare)))
    assert len(lines) == 2
    assert [line for line in lines if not ACTION.search(line)] == []


def test_pictures_that_are_left_out_say_what_is_missing_then():
    assert set(_HINTS) == set(SHOW_NOTHING)
    assert [hint for _, (hint, *_) in _HINTS.values() if "missing from the map" not in hint] == []


def test_a_tilt_says_what_may_be_wrong_and_what_to_check():
    tilt = AttitudeFloorTilt(np.array([0.1, 0.0]), np.array([0.1, 0.0]), 0.001, 0.001, 0.0)
    line = str(attitude_floor_tilt_warning(tilt))
    assert "heights may be wrong" in line
    assert ACTION.search(line)
