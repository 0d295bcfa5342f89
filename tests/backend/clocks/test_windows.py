"""A clock that is wrong in some part of a flight is seen there, and a right one nowhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from backend.clocks.windows import ClockDisagreement, clock_disagreements
from backend.measurements import InertialReadings
from backend.significance import FALSE_ALARM

IMU_S, PICTURE_S = 0.005, 0.125


def left(
    seed: int, delay_s: Callable[[np.ndarray], np.ndarray], lasts_s: float = 12.0, gain: float = 1.0
) -> tuple[ClockDisagreement, ...]:
    """Return what a made flight that sways shows, whose pictures at times (n,) are late by ``delay_s``."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.1, 1.0, (6, 3, 1)), rng.uniform(0, 2 * np.pi, (6, 3, 1))

    def attitude(at_s: np.ndarray) -> Rotation:
        waves = np.sin(2 * np.pi * frequency * at_s + phase).sum(axis=0).T / np.sqrt(3)
        return Rotation.from_euler("xyz", np.radians([2.0, 2.0, 3.0]) * waves)

    imu_s = np.arange(0.0, lasts_s, IMU_S)
    rate = (attitude(imu_s).inv() * attitude(imu_s + 1e-5)).as_rotvec() / 1e-5
    gyro = gain * rate + [0.01, -0.02, 0.01] + rng.normal(0.0, 1.5e-3 / np.sqrt(IMU_S), rate.shape)
    seen_s = np.arange(0.0, lasts_s - 0.01, PICTURE_S)
    seen = attitude(seen_s) * Rotation.from_rotvec(rng.normal(0.0, 1e-3, (len(seen_s), 3)))
    return clock_disagreements(
        seen_s + delay_s(seen_s),
        seen.as_matrix(),
        np.zeros(len(seen_s), dtype=np.int64),
        InertialReadings(imu_s, gyro, np.zeros_like(gyro)),
    )


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_a_step_shortly_before_the_end_is_seen(sign: float):
    (span,) = left(1, lambda t: np.where(t > 9.6, sign * 0.4, 0.0))
    assert abs(span.delay_s - sign * 0.4) < 4 * span.std_s < 0.1
    assert 8.5 < span.begin_s < 10.5
    assert span.end_s > 11.0


def test_a_step_shortly_after_the_begin_is_seen():
    (span,) = left(2, lambda t: np.where(t < 1.5, 0.2, 0.0))
    assert abs(span.delay_s - 0.2) < 4 * span.std_s < 0.1
    assert span.end_s < 2.7


def test_two_steps_that_cancel_are_seen_between_them():
    (span,) = left(3, lambda t: np.where((t > 4.8) & (t < 7.2), 0.3, 0.0))
    assert abs(span.delay_s - 0.3) < 4 * span.std_s < 0.1
    assert 4.0 < span.begin_s < span.end_s < 8.5


def test_a_drift_is_seen_at_both_ends():
    first, *_, last = left(4, lambda t: 0.03 * (t - 6.0))
    assert first.begin_s < 1.0
    assert first.delay_s < -0.05
    assert last.end_s > 11.0
    assert last.delay_s > 0.05


@pytest.mark.slow
def test_a_step_of_a_long_flight_is_seen_in_its_last_seconds():
    """Its windows are longer than that."""
    (span,) = left(5, lambda t: np.where(t > 57.5, 0.3, 0.0), lasts_s=60.0)
    assert abs(span.delay_s - 0.3) < 4 * span.std_s < 0.1
    assert span.begin_s > 56.0


def test_one_clock_and_delays_that_do_not_matter_are_not_told():
    assert left(6, lambda t: 0.0 * t) == ()
    assert left(7, lambda t: np.where(t > 9.6, 0.015, 0.0)) == ()


@pytest.mark.slow
def test_a_right_clock_is_reported_no_more_often_than_chance_allows():
    flights = 20
    told = sum(bool(left(seed, lambda t: 0.0 * t)) for seed in range(flights))
    assert binom.sf(told - 1, flights, FALSE_ALARM) > 1e-3


@pytest.mark.parametrize("gain", [-1.0, np.degrees(1.0)])
@pytest.mark.parametrize("seed", range(8, 12))
def test_a_gyro_that_contradicts_the_pictures_tells_no_delay(seed: int, gain: float):
    """Some delay explains turns of the wrong sign in some window of nearly every flight."""
    assert left(seed, lambda t: 0.0 * t, gain=gain) == ()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_delay_just_below_those_that_matter_is_not_told(seed: int):
    assert left(seed, lambda t: 0.0 * t + 0.0245) == ()


def test_too_few_pictures_tell_nothing():
    assert left(9, lambda t: 0.0 * t, lasts_s=0.8) == ()
