"""Errors of filter and smoother are as large as told, over drawn flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, RotationSpline
from scipy.stats import chi2, norm

from backend import se3
from backend.ekf.inputs import Series
from backend.ekf.track import track
from tests.backend.made_motion import KNOWN, MODEL, as_the_flight_moves, error_of, fly, read, start_of


def mean_nees(states, flight, at_s):
    """Per degree of freedom: of the poses, and of the velocities."""
    xi = se3.log(se3.inverse(states.w_T_b) @ flight.w_T_b(at_s))
    v = states.w_v_m_s - flight.position.at(at_s, 1)
    P, Pv = states.covariances, states.motion_covariances[:, 3:6, 3:6]
    pose = np.einsum("na,nab,nb->n", xi, np.linalg.inv(P), xi).mean() / 6
    return pose, np.einsum("na,nab,nb->n", v, np.linalg.inv(Pv), v).mean() / 3


def consistency(seeds, model, rounds):
    """Mean NEES per degree of freedom of filter and smoother, and of one late instant, one row a seed.

    Errors within a flight are nearly one error: what is independent is one flight from the next.
    """
    at_s = np.arange(1.0, 20.0, 0.5)
    rows = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        fitting = as_the_flight_moves(flight, model)
        readings = read(flight, fitting, rng, seconds=20.0)
        found = track(readings, at_s, start_of(flight, readings, rng), fitting, rounds=rounds)
        chosen = found.smoothed if found.smoothed is not None else found.filtered
        late = error_of(chosen, flight, at_s, 30)
        rows.append((*mean_nees(chosen, flight, at_s), late))
    return np.array(rows)


def assert_consistent(rows):
    """Two-sided: the late instant's chi-square over seeds in its 99.9 % band, the means near 1."""
    n = len(rows)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * n) / (6 * n)
    assert low < rows[:, 2].mean() / 6 < high, (rows[:, 2].mean() / 6, low, high)
    for column in (0, 1):
        error = rows[:, column].std(ddof=1) / np.sqrt(n)
        assert abs(rows[:, column].mean() - 1) < max(4 * error, 0.15), (column, rows[:, column].mean(), error)


@pytest.mark.slow
def test_filter_is_consistent():
    assert_consistent(consistency(range(8), KNOWN, rounds=0))


@pytest.mark.slow
def test_smoother_is_consistent_with_unknown_scales():
    assert_consistent(consistency(range(100, 106), MODEL, rounds=3))


@pytest.mark.slow
@pytest.mark.parametrize(("model", "rounds"), [(KNOWN, 0), (KNOWN, 1), (MODEL, 3)])
def test_consistent_over_fifty_seeds(model, rounds):
    rows = consistency(range(50), model, rounds)
    low, high = chi2.ppf([0.025, 0.975], 6 * 50) / (6 * 50)
    print(f"late NEES {rows[:, 2].mean():.2f} of 6 in [{6 * low:.2f}, {6 * high:.2f}]")
    assert low < rows[:, 2].mean() / 6 < high
    assert_consistent(rows)


def test_innovations_are_white_and_of_unit_variance():
    rng = np.random.default_rng(5)
    flight = fly(rng)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=40.0)
    found = track(readings, np.array([39.0]), start_of(flight, readings, rng), model, rounds=0)
    for name in ("attitude", "range", "velocity"):
        channel = found.channels[name]
        z = (channel.innovation / channel.std)[len(channel.stamps_s) // 10 :]
        for axis in np.flatnonzero(np.isfinite(z).any(axis=0)):
            n = len(z)
            low, high = chi2.ppf([0.0005, 0.9995], n) / n
            # A margin on the low side: the motion is taken for four times as lively as it is.
            assert low - 0.06 < np.mean(z[:, axis] ** 2) < high, (name, axis, np.mean(z[:, axis] ** 2))
            for lag in (1, 2, 5):
                assert abs(np.mean(z[lag:, axis] * z[:-lag, axis])) < norm.ppf(0.9995) / np.sqrt(n) + 0.02


@pytest.mark.parametrize("clone", ["none", "first"])
def test_places_of_imu_and_antenna_move_no_pose(clone):
    """Two flights with one truth and one noise, their instruments at the origin and far from it."""
    rng = np.random.default_rng(3)
    flight, at_s = fly(rng), np.arange(1.0, 9.0, 0.5)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=10.0)
    fixes_s, b_p_imu_m, b_p_antenna_m = np.arange(0.1, 10.0, 0.2), (0.4, -0.2, 0.1), (-1.0, 0.5, 0.3)
    places = flight.position.at(fixes_s) + rng.normal(0, 0.1, (len(fixes_s), 3))
    readings = replace(
        readings, velocity_m_s=None, range_m=None, w_p_antenna_m=Series(fixes_s, places, np.full(3, 0.1))
    )
    start = replace(start_of(flight, readings, rng), place_std_m=0.5)
    accel = readings.accel_m_s2
    fine_s = np.arange(-0.1, 10.1, 0.01)
    turn = RotationSpline(fine_s, Rotation.from_matrix(flight.w_T_b(fine_s)[:, :3, :3]))
    rate = turn(accel.stamps_s, 1)
    across = np.cross(turn(accel.stamps_s, 2), b_p_imu_m) + np.cross(rate, np.cross(rate, b_p_imu_m))
    moved = replace(
        readings,
        accel_m_s2=replace(accel, values=accel.values + across),
        w_p_antenna_m=Series(
            fixes_s, places + flight.w_T_b(fixes_s)[:, :3, :3] @ b_p_antenna_m, np.full(3, 0.1)
        ),
    )
    levers = replace(model, b_p_imu_m=b_p_imu_m, b_p_position_m=b_p_antenna_m)
    one = track(readings, at_s, start, model, clone=clone).smoothed
    other = track(moved, at_s, start, levers, clone=clone).smoothed
    std_m = np.sqrt(np.trace(one.covariances[:, 3:, 3:], axis1=1, axis2=2))
    np.testing.assert_array_less(np.linalg.norm(other.w_T_b[:, :3, 3] - one.w_T_b[:, :3, 3], axis=1), std_m)
    assert max(mean_nees(other, flight, at_s)) < 2
    np.testing.assert_allclose(other.covariances, one.covariances, rtol=0.3, atol=0.2 * std_m.min() ** 2)
    if clone == "first":
        ratio = np.trace(other.fixed_clone_covariances[1:], axis1=1, axis2=2) / np.trace(
            one.fixed_clone_covariances[1:], axis1=1, axis2=2
        )
        np.testing.assert_allclose(ratio, 1, atol=0.2)
