"""Motion of state and covariance against differences, composition, and a numerical integral."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from backend.ekf import motion as at

MODEL = np.concatenate([[1.5, 0.4, 0.8, 0.3, 1e-3, 2e-3, 0.05, 20.0, 0.01, 0.1, 1.5, 0.2], np.zeros(9)])
WORK = np.zeros((at.MOVING, at.SIZE))
NOWHERE = np.zeros(0)
"""No point of linearisation: errors are about the propagated state."""


def drawn_state(rng):
    x = rng.normal(0, 1, at.STATE)
    for first in (at.X_ROT, at.X_CLONE_ROT):
        x[first : first + 4] = Rotation.random(rng=rng).as_quat(scalar_first=True)
    return x


def difference(y, x):
    """The error that takes state x to state y."""
    e = np.zeros(at.SIZE)
    e[: at.ROT], e[at.RATE : at.CLONE_POS] = (y - x)[: at.X_ROT], (y - x)[at.X_RATE : at.X_CLONE_POS]
    e[at.CLONE_POS : at.CLONE_ROT] = (y - x)[at.X_CLONE_POS : at.X_CLONE_ROT]
    for error, first in ((at.ROT, at.X_ROT), (at.CLONE_ROT, at.X_CLONE_ROT)):
        a, b = (Rotation.from_quat(s[first : first + 4], scalar_first=True) for s in (x, y))
        e[error : error + 3] = (a.inv() * b).as_rotvec()
    return e


def matrix(F):
    """The transition as a matrix: its columns are what it makes of unit errors."""
    columns = np.eye(at.SIZE)
    for column in columns:
        at.apply_transition(F, column, WORK)
    return columns.T


def retracted(x, e):
    y = np.empty(at.STATE)
    at.retract(x, e, y)
    return y


def moved(x, dt):
    y, F = x.copy(), np.zeros((at.MOVING, at.MOVING))
    C = np.zeros((at.SIZE, at.SIZE))
    at.propagate(y, C, dt, MODEL, NOWHERE, F, WORK)
    return y, C, F


@pytest.mark.parametrize("seed", range(3))
def test_transition_against_differences(seed):
    x = drawn_state(np.random.default_rng(seed))
    y, _, F = moved(x, 0.02)
    transition = matrix(F)
    for k in range(at.SIZE):
        e = np.zeros(at.SIZE)
        e[k] = 1e-6
        column = (
            difference(moved(retracted(x, e), 0.02)[0], y) - difference(moved(retracted(x, -e), 0.02)[0], y)
        ) / 2e-6
        # The turn by which the body rate acts is taken to second order in the step.
        np.testing.assert_allclose(transition[:, k], column, atol=2e-5)


def turned_about_vertical(x):
    """The error of a state whose whole path is turned about the vertical, with the vehicle's own yaw."""
    up, e = np.array([0.0, 0.0, 1.0]), np.zeros(at.SIZE)
    e[at.POS : at.VEL], e[at.VEL : at.ACC] = np.cross(up, x[: at.VEL]), np.cross(up, x[at.VEL : at.ACC])
    e[at.ROT : at.RATE] = Rotation.from_quat(x[at.X_ROT : at.X_RATE], scalar_first=True).inv().apply(up)
    e[at.ATTITUDE_ERROR + 2] = -1.0
    return e


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_of_the_whole_path_stays_one(seed):
    """Nothing in the motion tells the heading, also about a point that was smoothed with other noise."""
    rng = np.random.default_rng(seed)
    x = drawn_state(rng)
    start, y, F, C = x.copy(), x.copy(), np.zeros((at.MOVING, at.MOVING)), np.zeros((at.SIZE, at.SIZE))
    at.propagate(y, C, 0.02, MODEL, NOWHERE, F, WORK)
    point = retracted(y, np.where(np.arange(at.SIZE) < at.ATTITUDE_ERROR, rng.normal(0, 0.3, at.SIZE), 0.0))
    y = x.copy()
    at.propagate(y, np.zeros_like(C), 0.02, MODEL, point, F, WORK)
    expected, found = turned_about_vertical(point), matrix(F) @ turned_about_vertical(start)
    inner = slice(at.ACC, at.SIZE)
    np.testing.assert_allclose(found[inner], expected[inner], atol=1e-12)
    np.testing.assert_allclose(found[: at.ACC], turned_about_vertical(y)[: at.ACC], atol=1e-12)


def test_pulling_back_is_the_transpose():
    rng = np.random.default_rng(0)
    _, _, F = moved(drawn_state(rng), 0.03)
    transition = matrix(F)
    L, y = rng.normal(0, 1, (at.SIZE, at.SIZE)), rng.normal(0, 1, at.SIZE)
    L = L + L.T
    expected = transition.T @ L @ transition, transition.T @ y
    back = np.ascontiguousarray(F.T)
    at.transform_covariance(back, L, WORK)
    at.apply_transition(back, y, WORK)
    np.testing.assert_allclose(L, expected[0], atol=1e-12)
    np.testing.assert_allclose(y, expected[1], atol=1e-12)


@pytest.mark.parametrize("dt", [1e-4, 0.005, 0.0079, 0.0081, 0.05, 0.7, 5.0])
def test_correlated_signal_against_the_matrix_exponential(dt):
    """Van Loan 1978: transition and noise of the chain of integrators from one exponential."""
    std, tau = 1.5, 0.4
    A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / tau]])
    noise = np.zeros((3, 3))
    noise[2, 2] = 2 * std**2 / tau
    big = expm(np.block([[-A, noise], [np.zeros((3, 3)), A.T]]) * dt)
    transition = big[3:, 3:].T
    expected = transition @ big[:3, 3:]
    step, q = at.integrate_correlated(dt, std, tau)
    np.testing.assert_allclose(step, transition[:, 2], rtol=1e-4)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.array(q) / scale, expected / scale, atol=0.02)


def test_two_steps_are_one():
    rng = np.random.default_rng(1)
    x = drawn_state(rng)
    B = rng.normal(0, 1, (at.SIZE, at.SIZE))
    once, twice = x.copy(), x.copy()
    C1, F = B @ B.T, np.zeros((at.MOVING, at.MOVING))
    C2 = C1.copy()
    at.propagate(once, C1, 0.02, MODEL, NOWHERE, F, WORK)
    for _ in range(2):
        at.propagate(twice, C2, 0.01, MODEL, NOWHERE, F, WORK)
    np.testing.assert_allclose(once, twice, atol=1e-4)
    scale = np.sqrt(np.diag(C1))
    np.testing.assert_allclose(C1 / np.outer(scale, scale), C2 / np.outer(scale, scale), atol=2e-3)
    assert (np.linalg.eigvalsh(C1) > 0).all()
