"""Loops whose vertex numbers are shifted are named; the quadratic model agrees with the solved graphs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backend.g2o import read_g2o
from backend.pose_graph.checks.score_test import LinearisedEdges
from backend.pose_graph.checks.shifted_loops import shift_columns
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.linear import jacobian
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.generated_graphs import SHAPES, Scene, make
from tests.slam.faults.made_graph import laps


def shifted(graph: PoseGraph, first: int, second: int) -> PoseGraph:
    """All loops with other vertex numbers; those that lead out of the graph or become odometry are left."""
    loop, last = ~graph.is_odometry, len(graph.ids) - 1
    i, j = graph.i + first * loop, graph.j + second * loop
    fits = (np.minimum(i, j) >= 0) & (np.maximum(i, j) <= last) & (~loop | (np.abs(i - j) > 1))
    arrays = {name: getattr(graph, name)[fits] for name in ("ij_T", "information")}
    return replace(graph, i=i[fits], j=j[fits], **arrays)


def solved(graph: PoseGraph):
    return solve_pose_graph(graph, covariances=False)


@pytest.mark.parametrize("shape", SHAPES)
def test_right_numbers_are_not_doubted(shape):
    assert solved(make(Scene(shape, 1, 1, 0.0, "random", 1)).graph).status == "ok"


@pytest.mark.parametrize(
    ("first", "second"),
    [(-1, 0), *(pytest.param(first, 1, marks=pytest.mark.slow) for first in (0, 1))],
)
def test_shifted_numbers_are_named_with_the_way_back(first, second):
    status = solved(shifted(make(Scene("laps", 1, 1, 0.0, "random", 1)).graph, first, second)).status
    assert f"first ends move by {-first:+d} vertices along it and their second ends by {-second:+d}" in status


def test_the_information_is_what_the_poses_cannot_follow():
    """Against a dense projection by gtsam's Jacobian, with the change of the residuals by moved loops."""
    graph = make(Scene("laps", 1, 4, 0.0, "random", 1)).graph
    right, problem = solved(graph), from_pose_graph(graph)
    linearised = LinearisedEdges(problem, right.w_T_b)
    (test,) = linearised.score_tests(shift_columns(linearised))
    J = jacobian(problem.edge_factors(), problem.values(right.w_T_b)).toarray()[:, 3:]
    residual, change = problem.residuals(right.w_T_b), np.zeros((len(graph.i), 3))
    for e in np.flatnonzero(~graph.is_odometry):
        moved = []
        for j in (graph.j[e] - 1, graph.j[e] + 1):
            if j < len(graph.ids):
                ends = replace(problem, j=np.where(np.arange(len(graph.j)) == e, j, problem.j))
                moved.append((j - graph.j[e]) * (ends.residuals(right.w_T_b)[e] - residual[e]))
        change[e] = np.mean(moved, axis=0)
    left = change.ravel() - J @ np.linalg.lstsq(J, change.ravel())[0]
    assert test.information[1, 1] == pytest.approx(left @ left, rel=0.05)
    assert test.score[1] == pytest.approx(left @ residual.ravel(), abs=0.1 * np.sqrt(left @ left))
    assert test.statistic == pytest.approx(2 * right.error, rel=1e-3)


def test_the_score_of_right_numbers_has_the_variance_that_is_stated():
    """Two degrees of freedom for each graph: the mean of the whitened squares lies within chance of 2."""
    squares = []
    for seed in range(12):
        graph = make(Scene("laps", 1, 4, 0.0, "random", seed)).graph
        linearised = LinearisedEdges(from_pose_graph(graph), solved(graph).w_T_b)
        (test,) = linearised.score_tests(shift_columns(linearised))
        squares.append(test.score @ np.linalg.solve(test.information, test.score))
    assert abs(np.mean(squares) - 2) < 3.3 * np.sqrt(2 * 2 / len(squares))


def test_a_vehicle_that_stands_still_has_no_shift_to_find():
    """Where all poses are equal, a shift changes nothing, and the information is zero."""
    graph = make(Scene("laps", 1, 1, 0.0, "random", 1)).graph
    still = replace(
        graph, ij_T=np.tile(np.eye(4), (len(graph.i), 1, 1)), poses=np.tile(np.eye(4), (120, 1, 1))
    )
    assert "first ends" not in solved(still).status


def test_absurd_poses_give_no_test():
    graph = make(Scene("laps", 1, 4, 0.0, "random", 1)).graph
    far = solved(graph).w_T_b.copy()
    far[:, :3, 3] *= 1e200
    linearised = LinearisedEdges(from_pose_graph(graph), far)
    assert linearised.score_tests(shift_columns(linearised)) == [None]


@pytest.mark.parametrize("factor", [1e12, 1e13, 1e14, 1e16])
def test_an_edge_beside_which_the_rest_is_rounded_away_says_nothing_about_numbers(tmp_path: Path, factor):
    laps(tmp_path / "laps.g2o", 80, 40)
    graph = read_g2o(tmp_path / "laps.g2o")
    graph.information[85] *= factor
    assert solved(graph).status == "ok"
