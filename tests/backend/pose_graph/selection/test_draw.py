"""Graphs with many loops per pose: a draw of them places the poses, and judges the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.draw import draw_loops
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import unplaced_graph
from tests.benchmarks.generated_graphs import STD, Scene, make


def dense(poses: int, loops: int, seed: int) -> tuple[PoseGraph, np.ndarray, np.ndarray]:
    """Return a graph with half of its loops false, the true poses, and which edges (m,) are false."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.3, poses))
    steps = 0.5 * np.column_stack([np.cos(heading), np.sin(heading)])
    w_T = se3.from_planar(np.column_stack([np.cumsum(steps - 0.9 * steps.mean(axis=0), axis=0), heading]))
    ends = rng.integers(0, poses, (4 * loops, 2))
    ends = ends[np.abs(ends[:, 0] - ends[:, 1]) > 1][:loops]
    i, j = np.vstack([np.column_stack([np.arange(poses - 1), np.arange(1, poses)]), ends]).T
    ij_T = se3.inverse(w_T[i]) @ w_T[j] @ se3.from_planar(STD * rng.standard_normal((len(i), 3)))
    false = (np.arange(len(i)) >= poses - 1) & (rng.random(len(i)) < 0.5)
    wrong = rng.uniform(-1, 1, (np.count_nonzero(false), 3)) * (10, 10, np.pi)
    ij_T[false] = se3.from_planar(wrong)
    return unplaced_graph(i, j, ij_T, STD), w_T, false


def test_the_draw_holds_odometry_and_each_pair_of_places():
    graph, _, _ = dense(100, 2500, 0)
    problem = from_pose_graph(graph)
    drawn, other = draw_loops(problem, 0), draw_loops(problem, 1)
    assert drawn[problem.trusted].all()
    assert 1000 < np.count_nonzero(drawn) < 2000
    np.testing.assert_array_equal(drawn, draw_loops(problem, 0))
    assert (drawn != other).any()
    alone = np.flatnonzero(~problem.trusted & (problem.i < 20) & (problem.j >= 80))
    few = np.ones(len(problem.i), dtype=bool)
    few[alone[1:]] = False  # one loop alone joins its places
    rare = problem.with_edges(few)
    where = int(np.count_nonzero(few[: alone[0]]))
    assert all(draw_loops(rare, seed)[where] for seed in range(5))


def test_a_graph_of_few_loops_is_used_whole():
    made = make(Scene("laps", 3, 1, 0.5, "random", 0))
    assert draw_loops(from_pose_graph(made.graph), 0).all()


def test_a_selection_out_of_time_is_not_ok_and_says_what_to_do():
    made = make(Scene("laps", 1, 2, 0.5, "random", 0))
    solution = solve_pose_graph(made.graph, time_limit_s=0.0)
    assert "cut off" in solution.status
    assert "allow more time" in solution.status
    assert "cut off" not in solve_pose_graph(made.graph).status


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "loops"), [(100, 2500), (500, 5000)])
def test_half_of_very_many_loops_is_found_false(poses, loops):
    graph, w_T, false = dense(poses, loops, 0)
    steps = []
    solution = solve_pose_graph(graph, on_step=lambda number, error: steps.append(number), seed=3)
    assert solution.status == "ok"
    assert len(steps) > 10
    assert not (solution.edge_kept & false).any()
    assert np.count_nonzero(~solution.edge_kept & ~false) < 0.01 * loops
    off = se3.inverse(w_T[0]) @ w_T - se3.inverse(solution.w_T_b[0]) @ solution.w_T_b
    without = replace(
        graph,
        i=graph.i[~false],
        j=graph.j[~false],
        ij_T=graph.ij_T[~false],
        information=graph.information[~false],
    )
    oracle = solve_pose_graph(without)
    best = se3.inverse(w_T[0]) @ w_T - se3.inverse(oracle.w_T_b[0]) @ oracle.w_T_b
    assert np.linalg.norm(off[:, :2, 3]) < 1.2 * np.linalg.norm(best[:, :2, 3])
