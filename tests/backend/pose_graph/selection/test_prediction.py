"""Draws about a solution against dense algebra."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend.pose_graph.linear import elimination_order, jacobian
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.prediction import (
    first_scale,
    innovations,
    log_volume,
    noise_scale,
    sample_posterior,
    solve_covariance,
    squared_mahalanobis,
    white_noise,
    whitened_covariance,
    whitened_spread,
)
from backend.pose_graph.solve import solve_pose_graph
from backend.pose_graph.unary_factors import fixed
from tests.backend.synthetic import graph
from tests.benchmarks.selection_matrix import Scene, make


def factors_of(dimension: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, int]:
    problem = from_pose_graph(graph(4, dimension, n=30))
    factors = problem.edge_factors()
    factors.push_back(fixed(0, problem.initial[0], dimension).factor)
    return factors, problem.values(problem.initial), problem.dof


@pytest.mark.parametrize("dimension", [2, 3])
def test_draws_solve_the_whole_system_with_noise_on_its_right(dimension: int) -> None:
    factors, values, d = factors_of(dimension)
    J = jacobian(factors, values).toarray()
    noise = white_noise(len(J) + 50, d)
    expected = np.linalg.lstsq(J, noise[: len(J)], rcond=None)[0].reshape(30, d, -1)
    for found in (sample_posterior(factors, values, d), sample_posterior(factors, values, d, noise)):
        assert found is not None
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_variable_is_eliminated_in_one_piece(dimension: int) -> None:
    factors, values, d = factors_of(dimension)
    order = elimination_order(factors, d)
    assert sorted(order) == list(range(values.dim()))
    assert (order.reshape(-1, d) // d == order[::d, None] // d).all()
    np.testing.assert_array_equal(
        jacobian(factors, values, order).toarray(), jacobian(factors, values).toarray()[:, order]
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_covariance_without_the_spread_is_that_of_the_spread(dimension: int) -> None:
    problem = from_pose_graph(graph(4, dimension, n=30))
    samples = sample_posterior(*factors_of(dimension))
    assert samples is not None
    spread = whitened_spread(problem, problem.initial, samples, np.arange(len(problem.i)))
    expected = spread @ np.swapaxes(spread, 1, 2) / spread.shape[2]
    found = whitened_covariance(problem, problem.initial, samples)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("dimension", [2, 3])
def test_noise_beyond_the_stated_one_is_its_chi_square_per_degree_of_freedom(dimension: int) -> None:
    problem = from_pose_graph(graph(4, dimension, n=30))
    kept = np.ones(len(problem.i), dtype=bool)
    kept[-3:] = False
    statistic = float((problem.residuals(problem.initial)[kept] ** 2).sum())
    dof = problem.dof * (int(kept.sum()) - 30 + 1)
    larger = replace(problem, sqrt_information=problem.sqrt_information * np.sqrt(16 * dof / statistic))
    assert noise_scale(larger, kept, problem.initial) == pytest.approx(4.0)


def test_covariances_too_large_along_one_axis_are_right_along_another():
    """The headings have the stated noise, the positions a tenth of it: no factor below 1 holds for both."""
    made = make(Scene("laps", 1, 1, 0.0, "random", 0))
    root = np.linalg.cholesky(made.graph.information)
    less = root * np.array([0.1, 0.1, 1.0])[:, None]
    graph = replace(made.graph, information=less @ np.swapaxes(less, 1, 2))
    problem, solved = from_pose_graph(graph), solve_pose_graph(graph, covariances=False)
    kept = np.ones(len(problem.i), dtype=bool)
    assert 0.85 < noise_scale(problem, kept, solved.w_T_b) <= 1.0


def test_the_volume_of_an_ellipsoid_is_that_of_the_unit_ball_times_its_axes() -> None:
    """The unit balls have the volumes 4 pi / 3 and pi^3 / 6 (3 and 6 dimensions)."""
    for d, ball in ((3, 4 * np.pi / 3), (6, np.pi**3 / 6)):
        axes = np.arange(1.0, d + 1)
        found = log_volume(np.diag(axes**2), 4.0)
        assert found == pytest.approx(np.log(ball * axes.prod() * 2.0**d))


@pytest.mark.parametrize("dimension", [2, 3])
def test_residuals_of_exactly_zero_have_a_scale_above_zero(dimension: int) -> None:
    problem = from_pose_graph(graph(4, dimension, n=30))
    at_rest = replace(problem, ij_T=np.tile(np.eye(4), (len(problem.i), 1, 1)))
    w_T = np.tile(np.eye(4), (30, 1, 1))
    assert not at_rest.residuals(w_T).any()
    assert noise_scale(at_rest, np.ones(len(problem.i), dtype=bool), w_T) == 1e-3
    samples = np.random.default_rng(0).normal(size=(30, problem.dof, 60))
    loops = innovations(at_rest, w_T, samples, np.flatnonzero(~problem.trusted))
    assert 1e-3 <= first_scale(loops, np.arange(len(loops.edges))) < 2e-2


@pytest.mark.parametrize("corner", [1e20, 1.0 + 1e-9])
def test_a_covariance_that_rounding_spoils_counts_the_edges_own_noise(corner: float) -> None:
    """The matrix is singular in double precision, or has a negative eigenvalue."""
    spoilt = np.array([[np.round(corner), corner], [corner, np.round(corner)]])
    covariance, residual = np.array([spoilt, np.eye(2)]), np.array([[1.0, -1.0], [1.0, 2.0]])
    np.testing.assert_allclose(squared_mahalanobis(residual, covariance), [2.0, 5.0], rtol=1e-6)


def test_a_singular_covariance_is_inverted_on_its_axes() -> None:
    found = solve_covariance(np.full((2, 2), 1e20), np.array([[1.0], [-1.0]]))
    np.testing.assert_allclose(found, [[1.0], [-1.0]])
