"""What the sampling of a gyro leaves open about the delay of the pictures' clock."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

from backend.clocks.picture_clock import ClockPiece, picture_clock
from backend.clocks.sampling import sampling_std_s
from backend.measurements import InertialReadings

IMU_S, PICTURE_S, TICK_S, FINE_S, LASTS_S = 0.005, 1 / 15, 0.04, 0.0005, 25.0
LAG_S, TILT_RAD, ANGLE_RAD, DELAY_S = 0.1, 0.1, 5e-4, 0.03
"""Lag of the vehicle behind its commands, their size, error of a picture's attitude, and delay."""
SMOOTH_HZ = 1.0


def tilted(seed: int, jumps: bool) -> tuple[np.ndarray, Rotation]:
    """Return times and attitudes of a vehicle that follows commands with a lag, so that its rate jumps with
    each of them, or of one that sways as far without jumps."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(0.0, LASTS_S, FINE_S)
    if jumps:
        ticks = rng.normal(0.0, TILT_RAD, (int(LASTS_S / TICK_S) + 1, 2))
        command = ticks[(at_s / TICK_S + 1e-9).astype(int)]
        decay = np.exp(-FINE_S / LAG_S)
        tilt = lfilter([0.0, 1.0 - decay], [1.0, -decay], command, axis=0)
    else:
        hertz, phase = rng.uniform(0.1, SMOOTH_HZ, (6, 2, 1)), rng.uniform(0, 2 * np.pi, (6, 2, 1))
        tilt = TILT_RAD / np.sqrt(3) * np.sin(2 * np.pi * hertz * at_s + phase).sum(axis=0).T
    return at_s, Rotation.from_euler("xy", tilt)


def gyro(seed: int, jumps: bool) -> InertialReadings:
    """Return what a gyro with white noise reads, from a random share of its interval on."""
    rng = np.random.default_rng((seed, 1))
    at_s, attitude = tilted(seed, jumps)
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / FINE_S
    every = round(IMU_S / FINE_S)
    first = rng.integers(every)
    read, stamps_s = rate[first::every], (at_s[:-1] + FINE_S / 2)[first::every]
    noise = rng.normal(0.0, 1.5e-3 / np.sqrt(IMU_S), read.shape)
    return InertialReadings(stamps_s, read + noise + [0.01, -0.02, 0.01], np.zeros_like(read))


def clock_of(seed: int, jumps: bool) -> ClockPiece:
    """Return the one piece of the clock of pictures that are stamped late."""
    rng = np.random.default_rng((seed, 2))
    seen_s = np.arange(rng.uniform(0.0, PICTURE_S), LASTS_S - 0.1, PICTURE_S)
    true = Slerp(*tilted(seed, jumps))(seen_s)
    seen = true * Rotation.from_rotvec(rng.normal(0.0, ANGLE_RAD, (len(seen_s), 3)))
    chain = np.zeros(len(seen_s), dtype=np.int64)
    (piece,) = picture_clock(seen_s + DELAY_S, seen.as_matrix(), chain, gyro(seed, jumps)).pieces
    return piece


@pytest.mark.slow
@pytest.mark.parametrize("jumps", [True, False])
def test_the_delay_has_an_honest_deviation_whether_or_not_the_rate_jumps(jumps: bool):
    pieces = [clock_of(seed, jumps) for seed in range(30)]
    nees = sum(((piece.delay_s - DELAY_S) / piece.std_s) ** 2 for piece in pieces)
    assert chi2.ppf(0.005, 30) < nees < chi2.ppf(0.995, 30)


def test_jumps_leave_open_where_between_two_readings_they_are():
    assert sampling_std_s(gyro(0, True), PICTURE_S) == pytest.approx(IMU_S / np.sqrt(12), rel=0.1)


def test_a_smooth_motion_has_no_error_of_sampling():
    assert sampling_std_s(gyro(0, False), PICTURE_S) < 0.1 * IMU_S / np.sqrt(12)


@pytest.mark.parametrize("count", [0, 1, 6])
def test_too_few_readings_tell_of_no_jumps(count: int):
    readings = InertialReadings(IMU_S * np.arange(count), np.ones((count, 3)), np.zeros((count, 3)))
    assert sampling_std_s(readings, PICTURE_S) == 0.0
