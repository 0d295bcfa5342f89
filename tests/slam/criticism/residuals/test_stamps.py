"""Stamps off an even clock: distinguished from readings at uneven times, measured, and corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.readings import ATTITUDE, IMU
from slam.criticism.residuals.corrected_readings import _streams, without_jitter
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from tests.slam.criticism.judged_flights import NOMINAL, SLOWER, judged

PLAN = ["short pulses of 0.2 s forward at half stick", "brisk climb steps at full stick"]
SEEDS = (3, 4)


def flights(model, seeds=SEEDS):
    return [simulate_flight(model, stick_for(PLAN), seed) for seed in seeds]


@pytest.mark.parametrize("sigma", [pytest.param(0.0015, marks=pytest.mark.slow), 0.008])
def test_jitter_is_reported_with_its_size_and_corrected(sigma):
    shaken = judged(flights(SLOWER.with_term("timestamp_jitter", sigma=sigma), SEEDS[:1]))
    even, found = without_jitter(shaken, NOMINAL)
    assert [o.name for o in found] == ["timestamp_jitter"]
    size = found[0].parameters["sigma"]
    assert size.value == pytest.approx(sigma, rel=0.1)
    assert size.low < sigma < size.high
    for was, now in zip(shaken, even, strict=True):
        assert (np.diff(now.times_s) >= 0).all()
        for kind in np.unique(was.kinds):
            assert np.array_equal(
                now.values[now.kinds == kind], was.values[was.kinds == kind], equal_nan=True
            )
            periods_s = np.diff(now.times_s[now.kinds == kind])
            assert np.quantile(np.abs(periods_s - np.median(periods_s)), 0.9) < 1e-6


def test_healthy_stamps_cost_nothing():
    healthy = judged(flights(SLOWER))
    same, found = without_jitter(healthy, NOMINAL)
    assert found == []
    assert all(now is was for now, was in zip(same, healthy, strict=True))


@pytest.mark.slow
def test_readings_that_were_taken_unevenly_and_stamped_so_keep_their_stamps():
    often = {"rate_hz": 500.0}
    fast = replace(
        SLOWER, attitude=replace(SLOWER.attitude, **often), velocity=replace(SLOWER.velocity, **often)
    )
    rng = np.random.default_rng(5)

    def thinned(stream, **fields):
        # Each tenth reading or one near it, stamped when it was taken.
        rows = np.arange(10, len(stream.stamps_s) - 10, 10)
        rows = rows + rng.integers(-3, 4, len(rows))
        return replace(stream, stamps_s=stream.stamps_s[rows], **{n: v[rows] for n, v in fields.items()})

    uneven = judged(
        replace(
            f,
            attitude=thinned(f.attitude, roll_pitch_yaw_rad=f.attitude.roll_pitch_yaw_rad),
            velocity=thinned(f.velocity, v_m_s=f.velocity.v_m_s),
        )
        for f in flights(fast)
    )
    same, found = without_jitter(uneven, NOMINAL)
    assert found == []
    assert all(now is was for now, was in zip(same, uneven, strict=True))


def test_a_stream_with_lost_readings_has_no_even_clock():
    rng = np.random.default_rng(6)

    def lost(flight):
        kept = np.sort(rng.choice(len(flight.imu.stamps_s), int(0.97 * len(flight.imu.stamps_s)), False))
        imu = replace(
            flight.imu,
            stamps_s=flight.imu.stamps_s[kept],
            gyro_rad_s=flight.imu.gyro_rad_s[kept],
            accel_m_s2=flight.imu.accel_m_s2[kept],
        )
        return replace(flight, imu=imu)

    sparse = judged(map(lost, flights(SLOWER)))
    assert all(IMU not in _streams(record) and ATTITUDE in _streams(record) for record in sparse)
    assert without_jitter(sparse, NOMINAL)[1] == []
