"""The factor of an IMU: gtsam's own error, its Jacobians by differences, and no error for true motion."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from backend.bundle.factors import LOG_SCALE, MOUNT, SLOPE, WORLD, WORLD_SIZE
from backend.bundle.inertial.factor import (
    ARM,
    DELAY,
    GAINS,
    GYRO_GAINS,
    IMU,
    IMU_SIZE,
    IntervalKeys,
    gain_effect,
    inertial_factor,
)
from backend.bundle.world import WorldTransform
from backend.measurements import Inertial, InertialNoise, InertialReadings
from backend.preintegration.intervals import STATE_SIZE, chains, preintegrate
from tests.backend.made_floor import NADIR
from tests.backend.made_motion import fly

OF_INTERVAL = range(6)
KEYS = IntervalKeys(*OF_INTERVAL)
SIZES = {0: 6, 1: 3, 2: 6, 3: 3, 4: 6, 5: 6, WORLD: WORLD_SIZE, IMU: IMU_SIZE}
"""Size of each variable by its key."""
SEEDS = st.integers(0, 2**32 - 1)
MODEL = gtsam.noiseModel.Unit.Create(STATE_SIZE)
NOISE = InertialNoise(gyro_walk=1e-3, accel_walk=1e-2)


def readings_of(
    flight, seconds=1.0, rate_hz=1000.0, arm_m=np.zeros(3), gain=0.0, gyro_gain=0.0
) -> InertialReadings:
    """Exact readings of an IMU that stands ``arm_m`` from the body's origin."""
    t = np.arange(-0.2, seconds + 0.2, 1 / rate_hz)
    step = 1e-4

    def place(at: np.ndarray) -> np.ndarray:
        T = flight.w_T_b(at)
        return T[:, :3, 3] + T[:, :3, :3] @ arm_m

    acceleration = (place(t + step) - 2 * place(t) + place(t - step)) / step**2 + [0, 0, 9.80665]
    force = np.einsum("nba,nb->na", flight.w_T_b(t)[:, :3, :3], acceleration)
    return InertialReadings(t, np.exp(gyro_gain) * flight.body_rate(t), np.exp(gain) * force)


def gains_of(flight, ends_s: np.ndarray) -> np.ndarray:
    T, lasts_s = flight.w_T_b(ends_s), float(ends_s[1] - ends_s[0])
    return gain_effect(T[0, :3, :3], T[:, :3, 3], flight.position.at(ends_s, 1), lasts_s)


def drawn_world(rng: np.random.Generator) -> np.ndarray:
    world = np.zeros(WORLD_SIZE)
    world[LOG_SCALE], world[1] = rng.normal(0, 0.3), rng.normal()
    world[SLOPE], world[MOUNT] = rng.normal(0, 0.05, 2), rng.normal(0, 0.05, 2)
    return world


def camera_pose(w_T_b: np.ndarray, world: np.ndarray) -> gtsam.Pose3:
    """The camera over the floor in mean heights whose body is at ``w_T_b``."""
    transform = WorldTransform(world, NADIR)
    metric = transform.w_T_f.inverse().compose(gtsam.Pose3(w_T_b)).compose(transform.b_T_c)
    return gtsam.Pose3(metric.rotation(), metric.translation() / transform.scale)


def true_values(flight, world: np.ndarray, imu: np.ndarray, ends_s: np.ndarray, delay: float) -> gtsam.Values:
    """Values of true motion, for pictures that were exposed ``delay`` before their stamps."""
    T, step = flight.w_T_b(ends_s - delay), 1e-5
    arms = [flight.w_T_b(ends_s + s) for s in (-step, step)]
    velocity = ((arms[1] - arms[0]) @ np.append(imu[ARM], 1.0))[:, :3] / (2 * step)
    values = gtsam.Values()
    for k in range(2):
        values.insert(2 * k, camera_pose(T[k], world))
        values.insert(2 * k + 1, velocity[k])
        values.insert(4 + k, gtsam.imuBias.ConstantBias())
    values.insert(WORLD, world)
    values.insert(IMU, imu)
    return values


def moved(values: gtsam.Values, key: int, step: np.ndarray) -> gtsam.Values:
    out = gtsam.Values(values)
    if key in (0, 2):
        out.update(key, values.atPose3(key).retract(step))
    elif key in (4, 5):
        out.update(key, values.atConstantBias(key).retract(step))
    else:
        out.update(key, values.atVector(key) + step)
    return out


def numeric(factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, size: int) -> np.ndarray:
    columns = []
    for axis in range(size):
        ends = []
        for sign in (1.0, -1.0):
            step = np.zeros(size)
            step[axis] = sign * 1e-6
            ends.append(factor.unwhitenedError(moved(values, key, step)))
        columns.append((ends[0] - ends[1]) / 2e-6)
    return np.column_stack(columns)


def drawn_factor(seed: int) -> tuple[gtsam.CustomFactor, gtsam.Values]:
    """A factor, and values that are off by some of everything."""
    rng = np.random.default_rng(seed)
    flight = fly(rng)
    stds = [0.02] * 3 + [0.05] * 3 + [0.02] * 4
    imu = rng.normal(0, stds)
    (interval,) = preintegrate(Inertial(readings_of(flight, 0.4, 200.0), NOISE), np.array([0.0, 0.4]))
    by_gain = gains_of(flight, np.array([0.0, 0.4]))
    factor = inertial_factor(interval, interval.whitening(1.0, 1.0), by_gain, KEYS, NADIR, MODEL)
    values = true_values(flight, drawn_world(rng), imu, np.array([0.0, 0.4]), 0.0)
    for key in OF_INTERVAL:
        values = moved(values, key, rng.normal(0, 0.02, SIZES[key]))
    return factor, values


@settings(deadline=None, max_examples=10)
@given(SEEDS)
def test_its_jacobians_are_those_of_differences(seed):
    factor, values = drawn_factor(seed)
    linear, _ = factor.linearize(values).jacobian()
    each = np.split(linear, np.cumsum([*SIZES.values()])[:-1], axis=1)
    for (key, size), found in zip(SIZES.items(), each, strict=True):
        expected = numeric(factor, values, key, size)
        assert np.abs(found - expected).max() < 1e-4 * max(1.0, np.abs(expected).max())


@settings(deadline=None, max_examples=5)
@given(SEEDS)
def test_the_error_is_that_of_gtsam_on_metric_states(seed):
    rng = np.random.default_rng(seed)
    flight = fly(rng)
    ends_s = np.array([0.0, 0.4])
    (interval,) = preintegrate(Inertial(readings_of(flight, 0.4, 200.0), NOISE), ends_s)
    factor = inertial_factor(interval, np.eye(STATE_SIZE), gains_of(flight, ends_s), KEYS, NADIR, MODEL)
    world = drawn_world(rng)
    values = true_values(flight, world, np.zeros(IMU_SIZE), np.array([0.0, 0.4]), 0.0)
    for key in OF_INTERVAL:
        values = moved(values, key, rng.normal(0, 0.05, SIZES[key]))
    transform = WorldTransform(world, NADIR)
    bodies = [transform.body_pose(values.atPose3(key)) for key in (0, 2)]
    biases = [values.atConstantBias(key) for key in (4, 5)]
    expected = interval.factor.evaluateError(
        bodies[0], values.atVector(1), bodies[1], values.atVector(3), *biases
    )
    np.testing.assert_allclose(factor.unwhitenedError(values), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_true_motion_has_no_error_with_gains_arm_and_delay(seed):
    rng = np.random.default_rng(seed)
    flight, arm, delay, gain, gyro_gain = fly(rng), rng.normal(0, 0.1, 3), 0.01, 0.03, 0.03
    readings = readings_of(flight, 0.5, 1000.0, arm, gain, gyro_gain)
    ends_s = np.array([0.0, 0.5])
    (interval,) = preintegrate(Inertial(readings), ends_s)
    factor = inertial_factor(interval, np.eye(STATE_SIZE), gains_of(flight, ends_s), KEYS, NADIR, MODEL)
    imu = np.zeros(IMU_SIZE)
    imu[GAINS], imu[ARM], imu[DELAY], imu[GYRO_GAINS] = gain, arm, delay, gyro_gain
    world = drawn_world(rng)
    world[SLOPE] = 0.0
    error = factor.unwhitenedError(true_values(flight, world, imu, ends_s, delay))
    assert np.abs(error[:3]).max() < 5e-4
    assert np.abs(error[3:9]).max() < 5e-3
    for which in (GAINS, ARM, DELAY, GYRO_GAINS):
        wrong = imu.copy()
        wrong[which] = 0.0
        worse = factor.unwhitenedError(true_values(flight, world, wrong, ends_s, delay))
        rows = slice(0, 3) if which == GYRO_GAINS else slice(0, 9)
        assert np.linalg.norm(worse[rows]) > 2 * np.linalg.norm(error[rows])


def test_the_whitened_error_of_noisy_readings_is_chi_square():
    squares = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        exact = readings_of(flight, 0.3, 200.0)
        n = len(exact.stamps_s)
        noisy = InertialReadings(
            exact.stamps_s,
            exact.gyro_rad_s + rng.normal(0, 1.5e-3 * np.sqrt(200), (n, 3)),
            exact.accel_m_s2 + rng.normal(0, 0.05 * np.sqrt(200), (n, 3)),
        )
        ends_s = np.array([0.0, 0.3])
        (interval,) = preintegrate(Inertial(noisy), ends_s)
        whitening = interval.whitening(1.0, 1.0)
        factor = inertial_factor(interval, whitening, gains_of(flight, ends_s), KEYS, NADIR, MODEL)
        values = true_values(flight, np.zeros(WORLD_SIZE), np.zeros(IMU_SIZE), ends_s, 0.0)
        squares.append(float(np.sum(factor.unwhitenedError(values) ** 2)))
    low, high = chi2.ppf([0.001, 0.999], 9 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_intervals_with_a_gap_are_left_out_and_break_the_chain():
    flight = fly(np.random.default_rng(0))
    full = readings_of(flight, 2.0, 100.0)
    keep = (full.stamps_s < 0.9) | (full.stamps_s > 1.05)
    readings = InertialReadings(full.stamps_s[keep], full.gyro_rad_s[keep], full.accel_m_s2[keep])
    intervals = preintegrate(Inertial(readings), np.arange(0.0, 2.6, 0.25))
    assert [one.i for one in intervals] == [0, 1, 2, 5, 6, 7]
    assert [len(chain) for chain in chains(intervals)] == [3, 3]


def test_cut_intervals_and_those_with_an_invalid_reading_are_left_out():
    readings = readings_of(fly(np.random.default_rng(0)), 2.0, 100.0)
    inertial = Inertial(readings, invalid_s=np.array([0.6]))
    intervals = preintegrate(inertial, np.arange(0.0, 2.1, 0.5), cut={3})
    assert [one.i for one in intervals] == [0, 2]
