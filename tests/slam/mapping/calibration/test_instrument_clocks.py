"""Of pictures, gyro and attitude, the one that both others contradict is restamped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.clocks.picture_clock import ClockPiece, PictureClock
from slam.core.flight import Flight
from slam.core.messages import Kind
from slam.evaluation import evaluate
from slam.mapping.calibration.instrument_clocks import attitude_delay, on_one_clock
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown(1)


def _late(flight: Flight, stream: str, late_s: float) -> Flight:
    return flight.restamped([stream], lambda stamps_s: stamps_s + late_s)


def _pictures(delay_s: float, std_s: float = 0.003) -> PictureClock:
    return PictureClock((ClockPiece(float("-inf"), delay_s, std_s),), 0.5)


@pytest.mark.parametrize("late_s", [-0.2, -0.06, 0.06, 0.2])
def test_the_delay_of_an_attitude_is_found_within_its_deviation(flight, late_s: float):
    found = attitude_delay(_late(flight, "attitude", late_s))
    assert found is not None
    assert abs(found.delay_s - late_s) < 4 * found.std_s
    assert found.std_s < 0.005


@pytest.mark.parametrize("late_s", [-0.1, 0.08])
def test_an_imu_that_pictures_and_attitude_contradict_is_restamped(flight, late_s: float):
    fixed = on_one_clock(_late(flight, "imu", late_s), _pictures(-late_s))
    assert np.abs(fixed.imu.stamps_s - flight.imu.stamps_s).max() < 0.01
    assert np.array_equal(fixed.attitude.stamps_s, flight.attitude.stamps_s)
    (line,) = fixed.warnings
    assert line.startswith("imu0 is stamped")
    assert ("after" if late_s > 0 else "before") in line
    assert fixed.messages[0].kind is Kind.NOTE


def test_an_attitude_that_gyro_and_pictures_contradict_is_restamped(flight):
    fixed = on_one_clock(_late(flight, "attitude", 0.15), _pictures(0.0))
    assert np.abs(fixed.attitude.stamps_s - flight.attitude.stamps_s).max() < 0.01
    assert np.array_equal(fixed.imu.stamps_s, flight.imu.stamps_s)
    assert fixed.warnings[0].startswith("attitude0 is stamped")


def test_late_pictures_are_no_matter_of_gyro_and_attitude(flight):
    assert on_one_clock(flight, _pictures(0.1)) is flight
    assert on_one_clock(replace(flight, attitude=None), _pictures(0.1)).warnings == ()


@pytest.mark.parametrize("pictures", [None, _pictures(0.0, std_s=0.1)])
def test_without_pictures_that_tell_neither_is_believed(flight, pictures):
    late = _late(flight, "attitude", 0.15)
    fixed = on_one_clock(late, pictures)
    assert fixed.attitude is late.attitude
    assert fixed.imu is late.imu
    assert fixed.messages[0].kind is not Kind.NOTE


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["imu", "attitude"])
def test_a_map_with_one_late_instrument_is_that_with_all_on_time(flight, stream: str):
    """A late IMU displaced every pose along its way, 45 mm here, with the status ok."""
    late = _late(flight, stream, 0.09)
    errors = [evaluate(optimize(each), flight).ate_m.rmse for each in (flight, late)]
    assert errors[1] < errors[0] + 0.002
