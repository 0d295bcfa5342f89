"""Errors put into a flight's instruments are found in the map."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from backend.measurements import GRAVITY_M_S2
from slam import optimize
from slam.mapping.calibration.instrument_errors import attitude_errors
from tests.slam.small_flight import flown

OFFSET_RAD, WANDER_RAD = np.array([0.06, -0.03]), 0.2
ACCEL_OFF_M_S2 = np.array([0.1, -0.2, -0.6])


@pytest.fixture(scope="module")
def flight():
    """Its attitude leans, its heading runs away, its accelerometer is off."""
    clean = flown(3)
    series = clean.attitude
    share = (series.stamps_s - series.stamps_s[0]) / np.ptp(series.stamps_s)
    angles = series.roll_pitch_yaw_rad + np.column_stack(
        [np.tile(OFFSET_RAD, (len(share), 1)), WANDER_RAD * share]
    )
    return replace(
        clean,
        attitude=replace(series, roll_pitch_yaw_rad=angles),
        imu=replace(clean.imu, accel_m_s2=clean.imu.accel_m_s2 + ACCEL_OFF_M_S2),
    )


@pytest.mark.slow
def test_what_is_wrong_with_the_instruments_is_found_with_an_honest_deviation(flight):
    found = optimize(flight).instruments
    attitude = found.attitude
    sigmas = (np.array(attitude.offset_rad) - OFFSET_RAD) / np.hypot(attitude.offset_std_rad, 1e-3)
    assert np.abs(sigmas).max() < 4
    assert np.max(attitude.offset_std_rad) < 0.01
    assert attitude.heading_wander_rad == pytest.approx(WANDER_RAD, rel=0.1)
    off = (np.array(found.accelerometer.offset_m_s2) - ACCEL_OFF_M_S2) / found.accelerometer.offset_std_m_s2
    assert np.abs(off).max() < 4
    # At one heading, a floor that slopes by 2 % looks like an offset of its level axes.
    assert np.max(found.accelerometer.offset_std_m_s2) < 0.02 * GRAVITY_M_S2
    assert found.accelerometer.offset_std_m_s2[2] < 0.1


@pytest.mark.slow
def test_a_healthy_flight_s_instruments_are_reported_healthy():
    found = optimize(flown(3)).instruments
    assert np.abs(found.attitude.offset_rad).max() < 0.004
    assert found.attitude.heading_wander_rad < 0.03
    assert np.abs(found.accelerometer.offset_m_s2).max() < 0.1


@pytest.mark.slow
def test_what_was_not_recorded_is_not_judged(flight):
    stamps_s = np.linspace(1, 5, 20)
    poses = np.tile(np.eye(4), (20, 1, 1))
    assert attitude_errors(replace(flight, attitude=None), stamps_s, poses) is None
    assert attitude_errors(flight, stamps_s, poses, level=False) is None
    assert attitude_errors(flight, stamps_s, np.full((20, 4, 4), np.nan)) is None
    assert optimize(replace(flight, imu=None)).instruments.accelerometer is None


@pytest.mark.slow
def test_the_map_of_a_flight_whose_attitude_leans_says_so(flight):
    assert any("is tilted by" in w for w in optimize(flight).warnings)
    assert not any("is tilted by" in w for w in optimize(flown(3)).warnings)


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [-0.05, 0.0, 0.08])
def test_pictures_on_another_clock_are_reported_with_the_shift_that_mends_them(late_s):
    clean = flown(3)
    frames = replace(clean.frames, stamps_s=clean.frames.stamps_s + late_s)
    said = [w for w in optimize(replace(clean, frames=frames)).warnings if "stamped" in w]
    if not late_s:
        assert said == []
        return
    (told,) = said
    shift = re.search(r"cam0/data.csv by ([+-]\d+) ms", told)
    assert float(shift[1]) == pytest.approx(-1e3 * late_s, abs=8)
