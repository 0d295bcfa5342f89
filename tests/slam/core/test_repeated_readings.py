"""A block of readings that was copied is told; readings that merely repeat are not."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.flight import Flight
from slam.core.flight_info import describe
from slam.core.repeated_readings import repeated_readings, without_held_readings, without_stale_fixes
from slam.core.streams import Gps, Imu, Sonar, Velocity


def read(range_m: np.ndarray) -> Flight:
    return Flight("made", sonar=Sonar(0.05 * np.arange(len(range_m)), range_m, 0.01))


def test_a_copied_block_is_told_with_both_times():
    range_m = np.random.default_rng(0).normal(1.0, 0.01, 400)
    range_m[300:361] = range_m[100:161]
    (line,) = map(str, repeated_readings(read(range_m)))
    assert line.startswith("sonar0: its readings from 15.0 to 18.0 s repeat exactly those from 5.0 to 8.0 s")
    assert line in describe(read(range_m)).anomalies


def test_columns_are_compared_together():
    v_m_s = np.random.default_rng(0).normal(0.0, 0.1, (400, 2))
    v_m_s[200:260, 0] = v_m_s[100:160, 0]
    flight = Flight("made", velocity=Velocity(0.05 * np.arange(400), v_m_s, (0.1, 0.1)))
    assert repeated_readings(flight) == []


def test_a_sensor_that_is_coarse_or_rests_or_has_no_echo_is_not_told():
    rng = np.random.default_rng(0)
    assert repeated_readings(read(np.round(rng.normal(1.0, 0.01, 20_000), 2))) == []
    assert repeated_readings(read(np.full(400, 1.0))) == []
    assert repeated_readings(read(np.full(400, np.nan))) == []
    assert repeated_readings(read(np.repeat(rng.normal(1.0, 0.01, 40), 10))) == []
    assert repeated_readings(read(np.empty(0))) == []


def imu_of(values: np.ndarray) -> Flight:
    return Flight("made", imu=Imu(0.005 * np.arange(len(values)), values, values + 1))


def test_readings_that_a_logger_repeats_are_dropped_and_told():
    values = np.random.default_rng(0).normal(0, 0.1, (100, 3))
    flight = without_held_readings(imu_of(np.repeat(values, 8, axis=0)))
    assert flight.imu is not None
    np.testing.assert_array_equal(flight.imu.gyro_rad_s, values)
    np.testing.assert_allclose(flight.imu.stamps_s, 0.04 * np.arange(100))
    assert flight.warnings[0].startswith("imu0: 700 of 800 readings only repeat the one before")


def velocity_of(values: np.ndarray) -> Flight:
    return Flight("made", velocity=Velocity(0.1 * np.arange(len(values)), values))


@pytest.mark.parametrize(("std", "time_s"), [(0.5, 2.0), (0.5, 4.0), (1.0, 8.0)])
def test_coarse_readings_that_repeat_by_chance_stay(std: float, time_s: float):
    """A velocity in steps of 0.1 m/s changes at about every second or third reading."""
    rng, keep = np.random.default_rng(0), np.exp(-0.1 / time_s)
    values = np.zeros((1200, 2))
    for k in range(1, 1200):
        values[k] = keep * values[k - 1] + rng.normal(0, std * np.sqrt(1 - keep**2), 2)
    flight = velocity_of(np.round(values, 1))
    assert without_held_readings(flight) is flight


@pytest.mark.parametrize("ratio", [1.6, 2.5, 4.4, 20.3])
def test_a_logger_whose_rate_is_no_multiple_repeats_too(ratio: float):
    seen = np.floor(np.arange(2000) / ratio).astype(int)
    values = np.random.default_rng(0).normal(0, 0.1, (2001, 3))
    flight = without_held_readings(imu_of(values[seen]))
    assert flight.imu is not None
    assert len(flight.imu.stamps_s) == seen[-1] + 1


def test_readings_that_repeat_by_themselves_stay():
    rng = np.random.default_rng(0)
    stuck = np.concatenate([rng.normal(0, 0.1, (100, 3)), np.zeros((400, 3))])
    for values in (rng.normal(0, 0.1, (400, 3)), stuck, np.zeros((400, 3))):
        flight = imu_of(values)
        assert without_held_readings(flight) is flight


def fixes_along(east_m: np.ndarray, std_m: float = 0.5) -> Flight:
    """Fixes without altitude, five a second, whose stated errors are ``std_m``."""
    count = len(east_m)
    longitude = 8.0 + east_m / (111_320.0 * np.cos(np.radians(47.0)))
    noise_std_m = std_m, std_m, 2 * std_m
    gps = Gps(0.2 * np.arange(count), np.full(count, 47.0), longitude, np.full(count, np.nan), noise_std_m)
    return Flight("made", gps=gps)


def test_fixes_that_a_receiver_holds_are_left_out_and_told():
    east_m = 0.3 * np.arange(100) + np.random.default_rng(0).normal(0, 0.1, 100)
    held = np.where((np.arange(100) > 30) & (np.arange(100) <= 70), 30, np.arange(100))
    flight = without_stale_fixes(fixes_along(east_m[held]))
    assert flight.gps is not None
    np.testing.assert_allclose(flight.gps.stamps_s, 0.2 * np.concatenate([np.arange(31), np.arange(71, 100)]))
    assert flight.warnings[0].startswith("gps0: 40 of 100 fixes, from 6.2 to 14.0 s, repeat the place")


def test_fixes_of_a_vehicle_that_stands_or_of_coarse_digits_stay():
    noise_m = np.random.default_rng(0).normal(0, 0.5, 200)
    stands = np.concatenate([np.zeros(100), 0.3 * np.arange(100)])
    for east_m in (np.zeros(200), stands, np.round(noise_m), noise_m):
        flight = fixes_along(east_m)
        assert without_stale_fixes(flight) is flight
