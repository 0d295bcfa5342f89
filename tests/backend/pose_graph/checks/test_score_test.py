"""The score test eliminates the poses as dense algebra does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csc_array

from backend.pose_graph.checks.score_test import LinearisedEdges, by_end
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.generated_graphs import Scene, make


def dense_jacobian(problem, w_T):
    """The derivatives of small residuals by all poses but the first, block by block; gtsam's are exact."""
    J = np.zeros((len(problem.i), problem.dof, problem.count, problem.dof))
    first, second = by_end(problem, w_T)
    for e, (i, j) in enumerate(zip(problem.i, problem.j, strict=True)):
        J[e, :, i], J[e, :, j] = first[e], second[e]
    rows = len(problem.i) * problem.dof
    return J[:, :, 1:].reshape(rows, -1)


def test_what_is_left_of_each_parameter_is_its_part_that_the_poses_do_not_explain():
    graph = make(Scene("laps", 1, 1, 0.0, "random", 2)).graph
    linearised = LinearisedEdges(from_pose_graph(graph), solve_pose_graph(graph, covariances=False).w_T_b)
    J, residual = dense_jacobian(linearised.problem, linearised.w_T), linearised.residuals.ravel()
    change = np.random.default_rng(0).normal(size=(len(residual), 4))
    change[:, 2] = 0.0  # a parameter that changes nothing
    change[:, 3] = J @ np.random.default_rng(1).normal(size=J.shape[1])  # one that the poses explain
    test, first_two = linearised.score_tests(csc_array(change), csc_array(change[:, :2]))
    assert np.allclose(first_two.information, test.information[:2, :2], rtol=1e-12)
    values = np.column_stack([residual, change])
    left = values - J @ np.linalg.lstsq(J, values, rcond=None)[0]
    expected = left.T @ left / linearised.noise_scale**2
    size = np.sqrt(np.outer(*[(values**2).sum(axis=0)] * 2)) / linearised.noise_scale**2
    assert test.statistic == pytest.approx(expected[0, 0], rel=1e-9)
    assert np.all(np.abs(test.score - expected[0, 1:]) <= 1e-9 * size[0, 1:])
    assert np.all(np.abs(test.information - expected[1:, 1:]) <= 1e-9 * size[1:, 1:])


def test_absurd_residuals_have_no_test():
    graph = make(Scene("laps", 1, 1, 0.0, "random", 2)).graph
    w_T = solve_pose_graph(graph, covariances=False).w_T_b.copy()
    w_T[1, :3, 3] = 1e200
    none = csc_array((len(graph.i) * 3, 1))
    assert LinearisedEdges(from_pose_graph(graph), w_T).score_tests(none) == [None]
