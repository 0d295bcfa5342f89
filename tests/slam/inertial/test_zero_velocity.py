"""Intervals at rest: a gap in the readings is no motion, and a bench recording has none."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.streams import Imu
from slam.inertial.zero_velocity import RestWindows


def bench(gap_s: float, moves: bool) -> Flight:
    """A minute on the floor, the last third in flight if it ``moves``, with a gap in its middle."""
    rng, stamps_s = np.random.default_rng(0), np.arange(0.0, 60.0, 0.005)
    gyro, accel = rng.normal(0, 0.002, (2, len(stamps_s), 3))
    flies = moves * (stamps_s > 40.0)
    gyro += flies[:, None] * rng.normal(0, 0.3, gyro.shape)
    accel = 5 * accel + [0.0, 0.0, 9.81] + flies[:, None] * rng.normal(0, 1.0, accel.shape)
    kept = np.abs(stamps_s - 25.1) > gap_s / 2
    return Flight("made", imu=Imu(stamps_s[kept], gyro[kept], accel[kept]))


@pytest.mark.parametrize("gap_s", [0.0, 0.3, 2.3, 11.0])
def test_a_gap_is_no_motion(gap_s: float) -> None:
    assert not RestWindows.of(bench(gap_s, moves=False)).any_motion


@pytest.mark.parametrize("gap_s", [0.0, 2.3])
def test_motion_begins_where_readings_show_it(gap_s: float) -> None:
    found = RestWindows.of(bench(gap_s, moves=True))
    assert found.first_motion_s(0.0) == pytest.approx(40.0, abs=0.5)
    moves = found.moves_at(np.array([10.0, 30.0, 45.0, 55.0]))
    assert moves.tolist() == [False, False, True, True]


def test_readings_before_the_first_window_are_of_it() -> None:
    flight = bench(0.0, moves=False)
    assert flight.imu is not None
    stamps_s = flight.imu.stamps_s.copy()
    stamps_s[[0, 1]] = stamps_s[[1, 0]]
    imu = Imu(stamps_s, flight.imu.gyro_rad_s, flight.imu.accel_m_s2)
    assert not RestWindows.of(Flight("made", imu=imu)).any_motion
