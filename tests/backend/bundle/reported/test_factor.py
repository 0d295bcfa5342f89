"""The factor of reported motion: Jacobians by differences, no error for true motion, noise as stated."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from backend.bundle.factors import SLOPE, WORLD, WORLD_SIZE
from backend.bundle.reported.factor import (
    BIAS,
    CONSTANTS_SIZE,
    DRIFT,
    GAINS,
    LAG,
    REPORTED,
    IntervalNoise,
    ReportedKeys,
    reported_factor,
)
from backend.bundle.reported.integrate import integrate_reported
from backend.measurements import NO_REPORTED_NOISE, ReportedNoise
from tests.backend.bundle.inertial.test_factor import camera_pose, drawn_world
from tests.backend.bundle.reported.made_reported import NOISE, Errors, report
from tests.backend.made_floor import NADIR
from tests.backend.made_motion import fly

KEYS = ReportedKeys(0, 1, 2, 3)
SIZES = {0: 6, 1: 6, 2: 3, 3: 3, WORLD: WORLD_SIZE, REPORTED: CONSTANTS_SIZE}
"""Size of each variable by its key."""
MODEL = gtsam.noiseModel.Unit.Create(3)
PLAIN = IntervalNoise(np.eye(3), np.zeros(3))


def true_values(flight, world, constants, ends_s) -> gtsam.Values:
    values = gtsam.Values()
    for k, T in enumerate(flight.w_T_b(ends_s)):
        values.insert(k, camera_pose(T, world))
        values.insert(2 + k, np.zeros(3))
    values.insert(WORLD, world)
    values.insert(REPORTED, constants)
    return values


def moved(values: gtsam.Values, key: int, step: np.ndarray) -> gtsam.Values:
    out = gtsam.Values(values)
    if key in (0, 1):
        out.update(key, values.atPose3(key).retract(step))
    else:
        out.update(key, values.atVector(key) + step)
    return out


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_its_jacobians_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    flight, ends_s = fly(rng), np.array([0.0, 0.7])
    (interval,) = integrate_reported(report(flight, 1.0), ends_s)
    constants = np.array([1.1, 0.9, 0.1, -0.2, 0.05, 0.1])
    factor = reported_factor(interval, IntervalNoise.of(interval, NOISE), KEYS, NADIR, 3, MODEL)
    values = true_values(flight, drawn_world(rng), constants, ends_s)
    for key in (0, 1, 2, 3):
        values = moved(values, key, rng.normal(0, 0.1, SIZES[key]))
    linear, _ = factor.linearize(values).jacobian()
    columns = [
        (factor.unwhitenedError(moved(values, key, step)) - factor.unwhitenedError(moved(values, key, -step)))
        / 2e-6
        for key, size in SIZES.items()
        for step in 1e-6 * np.eye(size)
    ]
    expected = np.column_stack(columns)
    np.testing.assert_allclose(linear, expected, atol=1e-5 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("errors", "parts"),
    [
        (Errors((1.05, 0.95), (0.1, -0.2), 0.05), (GAINS, BIAS, DRIFT)),
        (Errors(lag_s=0.05), (LAG,)),
    ],
)
def test_true_motion_has_no_error_with_the_right_constants(errors, parts, seed):
    rng = np.random.default_rng(seed)
    flight, ends_s = fly(rng), np.array([0.0, 0.4])
    (interval,) = integrate_reported(report(flight, 1.0, errors, rate_hz=500.0), ends_s)
    factor = reported_factor(interval, PLAIN, KEYS, NADIR, 3, MODEL)
    constants = np.array([*errors.gains, *errors.bias_m_s, errors.drift_rad_s, errors.lag_s])
    world = drawn_world(rng)
    world[SLOPE] = 0.0
    error = np.abs(factor.unwhitenedError(true_values(flight, world, constants, ends_s)))
    assert error[:2].max() < 3e-3
    assert error[2] < 1e-4
    for which in parts:
        wrong = constants.copy()
        wrong[which] = 1.0 if which == GAINS else 0.0
        worse = factor.unwhitenedError(true_values(flight, world, wrong, ends_s))
        assert np.linalg.norm(worse) > 2 * np.linalg.norm(error)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.3, 3.0])
def test_the_whitened_error_of_noisy_readings_is_chi_square(seconds):
    """With the errors that fade left at zero, their variance at the ends is that of the error beside."""
    squares, ends_s = [], np.array([0.0, seconds])
    for seed in range(150):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        (interval,) = integrate_reported(report(flight, seconds, rng=rng, rate_hz=200.0), ends_s)
        noise = IntervalNoise.of(interval, NOISE)
        factor = reported_factor(interval, noise, KEYS, NADIR, 3, MODEL)
        world = np.zeros(WORLD_SIZE)
        values = true_values(flight, world, np.array([1.0, 1.0, 0, 0, 0, 0]), ends_s)
        linear, right = factor.linearize(values).jacobian()
        ends = linear[:, 12:18]
        kept = np.exp(-seconds / np.array(NOISE.time_s))
        joint = np.kron([[1, 0], [0, 1]], np.eye(3)) + np.kron([[0, 1], [1, 0]], np.diag(kept))
        squares.append(float(right @ np.linalg.solve(np.eye(3) + ends @ joint @ ends.T, right)))
    low, high = chi2.ppf([0.001, 0.999], 3 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_over_a_long_interval_an_error_that_fades_is_white():
    """Its integral then has the variance 2 s² T t, and the ends tell nothing of it."""
    (interval,) = integrate_reported(report(fly(np.random.default_rng(0)), 200.0), np.array([0.0, 200.0]))
    noise = IntervalNoise.of(replace(interval, moved=0j), ReportedNoise((0.0,) * 3, (0.05,) * 3, (0.5,) * 3))
    variance = np.diag(np.linalg.inv(noise.whitening.T @ noise.whitening))
    np.testing.assert_allclose(variance, 2 * 0.05**2 * 0.5 * 200.0, rtol=0.01)
    assert NO_REPORTED_NOISE.error == (0.0,) * 3


def test_intervals_with_a_gap_in_velocity_or_yaw_are_left_out():
    motion = report(fly(np.random.default_rng(0)), 3.0)
    of_velocity = (motion.stamps_s < 0.6) | (motion.stamps_s > 1.1)
    of_yaw = (motion.yaw_stamps_s < 1.6) | (motion.yaw_stamps_s > 2.1)
    torn = replace(
        motion,
        stamps_s=motion.stamps_s[of_velocity],
        v_m_s=motion.v_m_s[of_velocity],
        yaw_stamps_s=motion.yaw_stamps_s[of_yaw],
        yaw_rad=motion.yaw_rad[of_yaw],
    )
    assert [one.i for one in integrate_reported(torn, np.arange(0.0, 3.1, 0.5))] == [0, 5]
