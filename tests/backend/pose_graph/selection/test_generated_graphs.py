"""Made graphs with false loops: the true ones are kept, and the error is that of the true ones alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.chains import chain_members
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.false_loops import edges_of
from tests.benchmarks.generated_graphs import MadeGraph, Scene, make
from tests.benchmarks.graphs import aligned_rmse
from tests.benchmarks.selection_matrix import WITHIN, ratio


def error_m(w_T: np.ndarray, made: MadeGraph) -> float:
    return aligned_rmse(w_T[:, :3, 3], made.w_T[:, :3, 3])


@pytest.mark.parametrize(
    "scene",
    [
        Scene("laps", 1, 2, -1.0, "random", 0),
        Scene("laps", 1, 4, -1.0, "random", 0),
        pytest.param(Scene("laps", 1, 1, 0.6, "consistent", 0), marks=pytest.mark.slow),
        Scene("eights", 1, 2, 0.3, "random", 0),
        Scene("lawn mower", 1, 2, 0.6, "consistent", 0),
        pytest.param(Scene("lawn mower", 1, 2, 0.5, "random", 100), marks=pytest.mark.slow),
        Scene("laps", 2, 4, 0.25, "consistent", 0),
    ],
    ids=lambda scene: scene.label,
)
def test_error_is_that_of_the_true_loops_alone(scene: Scene):
    assert ratio("ours", scene) <= WITHIN


def test_one_false_loop_among_forty_is_the_only_one_rejected():
    made = make(Scene("laps", 1, 2, -1.0, "random", 0))
    solved = solve_pose_graph(made.graph, covariances=False)
    assert solved.status == "ok"
    assert np.array_equal(~solved.edge_kept, made.false)


def test_a_false_loop_is_rejected_where_covariances_are_far_too_large():
    """Standard deviations are stated ten times too large: the chi-square test of the whole graph passes."""
    made = make(Scene("laps", 1, 1, -1.0, "random", 0))
    graph = replace(made.graph, information=made.graph.information / 100)
    solved = solve_pose_graph(graph, covariances=False)
    assert np.array_equal(~solved.edge_kept, made.false)
    true = edges_of(graph, ~made.false)
    assert solve_pose_graph(true, covariances=False).edge_kept.all()


@pytest.mark.parametrize(
    ("scene", "stated"),
    [
        (Scene("laps", 1, 2, -1.0, "random", 0), 5.0),
        (Scene("laps", 1, 1, 0.5, "consistent", 7), 10.0),
        (Scene("laps", 2, 4, 0.1, "consistent", 7), 10.0),
        pytest.param(Scene("lawn mower", 2, 1, 0.5, "consistent", 7), 5.0, marks=pytest.mark.slow),
    ],
    ids=lambda given: given.label if isinstance(given, Scene) else f"{given:.0f} times",
)
def test_loops_are_judged_by_their_own_noise_where_the_stated_one_is_far_too_large(
    scene: Scene, stated: float
):
    """By the stated covariances, false loops agree by chance, or no prediction is sharp."""
    assert ratio("ours", scene, stated) <= WITHIN


@pytest.mark.parametrize("wrong", [[3.0, 0.0, 0.0], [0.0, 0.0, 1.57]], ids=["position", "heading"])
def test_one_wrong_step_of_odometry_is_found_and_named(wrong: list[float]):
    """All true loops over the step disagree with it; without it they agree."""
    made = make(Scene("laps", 1, 2, 0.0, "random", 0))
    ij_T = made.graph.ij_T.copy()
    ij_T[60] = ij_T[60] @ se3.from_planar(np.array([wrong]))[0]
    graph = replace(made.graph, ij_T=ij_T, poses=np.full_like(made.graph.poses, np.nan))
    solved = solve_pose_graph(graph, covariances=False)
    assert np.flatnonzero(~solved.edge_kept).tolist() == [60]
    assert "vertex 60 to vertex 61" in " ".join(solved.warnings)
    clean = solve_pose_graph(made.graph, covariances=False)
    assert error_m(solved.w_T_b, made) <= WITHIN * error_m(clean.w_T_b, made)


@pytest.mark.parametrize(
    "numbers",
    [pytest.param("gap", marks=pytest.mark.slow), pytest.param("step", marks=pytest.mark.slow), "symbols"],
)
def test_odometry_is_found_whatever_the_vertex_numbers_are(numbers: str):
    """Two robots; a missing number, a step of ten, and gtsam's symbols of two letters."""
    made = make(Scene("laps", 2, 2, 0.1, "random", 1))
    n = len(made.w_T)
    number, second = np.arange(n), np.arange(n) >= n // 2
    ids = {
        "gap": number + (number > 17),
        "step": 10 * number,
        "symbols": np.where(second, (ord("b") << 56) - n // 2, ord("a") << 56) + number,
    }[numbers]
    graph = replace(made.graph, ids=ids.astype(np.int64))
    assert np.array_equal(graph.is_odometry, made.odometry)
    assert [len(each) for each in chain_members(from_pose_graph(graph))] == [n // 2, n // 2]
    clean = solve_pose_graph(edges_of(graph, ~made.false), covariances=False, loops_robust=False)
    solved = solve_pose_graph(graph, covariances=False)
    assert error_m(solved.w_T_b, made) <= WITHIN * error_m(clean.w_T_b, made)


def test_edges_between_robots_are_never_odometry():
    """The last pose of one robot and the first of the next have symbols of two letters."""
    made = make(Scene("laps", 2, 4, 0.0, "random", 0))
    n = len(made.w_T)
    ids = np.where(np.arange(n) < n // 2, ord("a") << 56, ord("b") << 56) + np.arange(n)
    graph = replace(made.graph, ids=ids.astype(np.int64))
    joined = replace(graph, i=np.append(graph.i, n // 2 - 1), j=np.append(graph.j, n // 2))
    assert not joined.is_odometry[-1]
    assert replace(joined, ids=np.arange(n)).is_odometry[-1]


@pytest.mark.slow
def test_many_gained_loops_outvote_a_few_lost_ones() -> None:
    """Three false loops that agree with a step of odometry do not hold it against sixty true ones."""
    made = make(Scene("lawn mower", 2, 2, 0.5, "random", 100))
    kept = solve_pose_graph(made.graph, covariances=False).edge_kept
    assert not (kept & made.false).any()
    assert kept[~made.false].all()


@pytest.mark.slow
def test_one_false_loop_that_bends_the_map_against_a_row_of_true_ones_is_named() -> None:
    """Odometry allows the false loop, and the row it contradicts is one piece of evidence as it is."""
    made = make(Scene("lawn mower", 1, 2, 0.6, "random", 103))
    solved = solve_pose_graph(made.graph, covariances=False)
    wrong = np.flatnonzero(solved.edge_kept & made.false)
    assert len(wrong) == 1
    ends = f"vertex {made.graph.i[wrong[0]]} to vertex {made.graph.j[wrong[0]]}"
    assert solved.status != "ok"
    assert f"without 1 kept loop ({ends})" in solved.status
