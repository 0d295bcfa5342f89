"""Errors of reported motion from known paths."""

from __future__ import annotations

import gtsam
import numpy as np

from backend.bundle.reported.factor import planar_motion
from backend.bundle.reported.integrate import integrate_reported
from backend.bundle.reported.noise import LEAST_INTERVALS, Step, identify_reported_noise
from backend.measurements import NO_REPORTED_NOISE, ReportedMotion
from tests.backend.bundle.reported.made_reported import NOISE, Errors, report
from tests.backend.made_motion import MadeFlight, fly

STAMPS_S = np.arange(0.0, 120.0, 0.2)
WRONG = Errors(gains=(1.2, 0.8), bias_m_s=(0.3, -0.1), drift_rad_s=0.05)


def steps_of(flight: MadeFlight, motion: ReportedMotion, stamps_s: np.ndarray) -> list[Step]:
    poses = [gtsam.Pose3(T) for T in flight.w_T_b(stamps_s)]
    return [
        Step(one, *planar_motion(poses[one.i], poses[one.j], one.turn_rad)[:2])
        for one in integrate_reported(motion, stamps_s)
    ]


def integral_std(noise, seconds: float) -> np.ndarray:
    """Standard deviation of the integral of each channel over a long time."""
    density, error, time_s = (np.array(row) for row in noise)
    return np.sqrt((density**2 + 2 * error**2 * time_s) * seconds)


def test_levels_are_found_beside_gain_and_offset():
    """What counts in a gap is the error of the integral."""
    rng = np.random.default_rng(0)
    flight = fly(rng)
    steps = steps_of(flight, report(flight, 120.0, WRONG, rng), STAMPS_S)
    found = identify_reported_noise(steps, STAMPS_S, NO_REPORTED_NOISE)
    ratio = integral_std(found, 10.0) / integral_std(NOISE, 10.0)
    assert (ratio > 0.6).all()
    assert (ratio < 1.6).all()


def test_a_jump_is_an_error_that_lasts():
    rng = np.random.default_rng(0)
    flight = fly(rng)
    motion = report(flight, 120.0, rng=rng)
    motion.v_m_s[motion.stamps_s > 60.0, 0] += 0.5
    found = identify_reported_noise(steps_of(flight, motion, STAMPS_S), STAMPS_S, NO_REPORTED_NOISE)
    assert integral_std(found, 10.0)[0] > 2 * integral_std(NOISE, 10.0)[0]
    assert integral_std(found, 10.0)[1] < 1.6 * integral_std(NOISE, 10.0)[1]


def test_single_readings_that_are_far_off_do_not_count():
    rng = np.random.default_rng(0)
    flight = fly(rng)
    motion = report(flight, 120.0, rng=rng)
    motion.v_m_s[:: len(motion.v_m_s) // 20] += 50.0
    found = identify_reported_noise(steps_of(flight, motion, STAMPS_S), STAMPS_S, NO_REPORTED_NOISE)
    assert (integral_std(found, 10.0)[:2] < 2 * integral_std(NOISE, 10.0)[:2]).all()


def test_of_few_steps_the_noise_is_the_nominal_one():
    flight = fly(np.random.default_rng(0))
    steps = steps_of(flight, report(flight, 20.0), STAMPS_S[:100])
    assert identify_reported_noise(steps[: LEAST_INTERVALS - 1], STAMPS_S, NOISE) == NOISE
    assert identify_reported_noise(steps, STAMPS_S, NOISE) != NOISE
