"""The filter and its smoother against conditioning one dense Gaussian of all states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.ekf import motion as ekf_motion
from backend.ekf.inputs import FilterModel, InitialState, Readings, Series
from backend.ekf.track import track

STD, TAU = 1.5, 0.4


def line_model(**changes):
    """A vehicle that only moves: nothing is unknown but position, velocity and acceleration."""
    still = {"rate_rad_s": 1e-9, "tilt_error_rad": 0.0, "yaw_walk_rad": 0.0, "barometer_walk_m": 0.0}
    return FilterModel(accel_m_s2=STD, accel_time_s=TAU, **{**still, **changes})


def dense(stamps_s, readings_at, readings, std, asked):
    """Mean and covariance (3 asked) of position, velocity, acceleration along one axis, of all at once.

    Conditions one Gaussian of all states on all readings; nothing recursive.
    """
    first = np.diag([0.0, 0.5, 2.0]) ** 2
    transitions, noises = [np.eye(3)], [first]
    for dt in np.diff(stamps_s):
        step, q = ekf_motion.integrate_correlated(dt, STD, TAU)
        transitions.append(np.array([[1, dt, step[0]], [0, 1, step[1]], [0, 0, step[2]]]))
        noises.append(q)
    n = len(stamps_s)
    prior = np.zeros((3 * n, 3 * n))
    for i in range(n):
        prior[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = noises[i]
        if i:
            before = prior[3 * i - 3 : 3 * i, : 3 * i]
            prior[3 * i : 3 * i + 3, : 3 * i] = transitions[i] @ before
            prior[: 3 * i, 3 * i : 3 * i + 3] = (transitions[i] @ before).T
            prior[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += (
                transitions[i] @ prior[3 * i - 3 : 3 * i, 3 * i - 3 : 3 * i] @ transitions[i].T
            )
    H = np.zeros((len(readings), 3 * n))
    for row, k in enumerate(readings_at):
        H[row, 3 * k] = 1
    S = H @ prior @ H.T + std**2 * np.eye(len(readings))
    K = np.linalg.solve(S, H @ prior).T
    rows = np.concatenate([[3 * k, 3 * k + 1, 3 * k + 2] for k in asked])
    return (K @ readings)[rows], (prior - K @ H @ prior)[np.ix_(rows, rows)]


@pytest.fixture(scope="module")
def straight():
    """Positions read now and then; asked times between and on them."""
    rng = np.random.default_rng(3)
    read_s, asked_s = np.sort(rng.uniform(0, 2, 12)), np.array([0.3, 0.75, 1.4, 1.9])
    read_s[0] = 0.0
    values = rng.normal(0, 1, (12, 3))
    return read_s, asked_s, values


def run_straight(straight, **options):
    read_s, asked_s, values = straight
    start = InitialState(0.0, 0.0, np.eye(3), tilt_std_rad=1e-9, velocity_std_m_s=0.5, accel_std_m_s2=2.0)
    start = replace(start, rate_std_rad_s=1e-9)
    readings = Readings(w_p_antenna_m=Series(read_s, values, np.full(3, 0.2)))
    return track(readings, asked_s, start, line_model(gate_probability=1e-300), **options)


@pytest.mark.parametrize("clone", ["none", "first", "each"])
def test_smoother_is_the_gaussian_given_all_readings(straight, clone):
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, clone=clone).smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    for axis in range(3):
        mean, covariance = dense(stamps_s, at[0], values[:, axis], 0.2, at[1])
        parts = (smoothed.w_T_b[:, :3, 3], smoothed.w_v_m_s, smoothed.w_a_m_s2)
        got = np.column_stack([part[:, axis] for part in parts])
        np.testing.assert_allclose(got.ravel(), mean, atol=1e-6)
        rows = [axis, 3 + axis, 6 + axis]
        for k in range(4):
            block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            mine = smoothed.motion_covariances[k][np.ix_(rows, rows)]
            np.testing.assert_allclose(mine, block, rtol=1e-5, atol=1e-9)


def test_filter_is_the_gaussian_given_the_readings_until_then(straight):
    read_s, asked_s, values = straight
    filtered = run_straight(straight).filtered
    for k, until_s in enumerate(asked_s):
        early = read_s <= until_s
        stamps_s = np.unique(np.append(read_s[early], until_s))
        at = np.searchsorted(stamps_s, read_s[early]), [len(stamps_s) - 1]
        for axis in range(3):
            mean, covariance = dense(stamps_s, at[0], values[early, axis], 0.2, at[1])
            np.testing.assert_allclose(filtered.w_T_b[k, axis, 3], mean[0], atol=1e-6)
            mine = filtered.motion_covariances[k][axis, axis]
            np.testing.assert_allclose(mine, covariance[0, 0], rtol=1e-5)


def test_way_between_asked_times_has_the_joint_covariance(straight):
    """Not the sum of the two poses' own: their errors are nearly one."""
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, clone="each").smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    mean, covariance = dense(stamps_s, at[0], values[:, 0], 0.2, at[1])
    assert np.isnan(smoothed.clone_T_b[0]).all()
    for k in range(1, 4):
        pick = np.zeros(12)
        pick[3 * k], pick[3 * k - 3] = 1, -1
        np.testing.assert_allclose(smoothed.clone_T_b[k, 0, 3], pick @ mean, atol=1e-6)
        np.testing.assert_allclose(
            smoothed.clone_T_b_covariances[k][3, 3], pick @ covariance @ pick, rtol=1e-5
        )
        apart = covariance[3 * k, 3 * k] + covariance[3 * k - 3, 3 * k - 3]
        assert smoothed.clone_T_b_covariances[k][3, 3] < 0.9 * apart


def test_the_first_pose_kept_gives_covariances_relative_to_it(straight):
    read_s, asked_s, values = straight
    smoothed = run_straight(straight, clone="first").smoothed
    stamps_s = np.unique(np.concatenate([read_s, asked_s]))
    at = np.searchsorted(stamps_s, read_s), np.searchsorted(stamps_s, asked_s)
    _, covariance = dense(stamps_s, at[0], values[:, 0], 0.2, at[1])
    for k in range(1, 4):
        pick = np.zeros(12)
        pick[3 * k], pick[0] = 1, -1
        np.testing.assert_allclose(
            smoothed.fixed_clone_covariances[k][3, 3], pick @ covariance @ pick, rtol=1e-5
        )
