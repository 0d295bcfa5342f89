"""A path flown twice, some of whose loops are false by one common transform: a wrong map is never ``ok``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.checks import rival_groups
from backend.pose_graph.checks.improbability import MovedRivals
from backend.pose_graph.checks.rival_maps import rival_maps
from backend.pose_graph.gauge_fixed_problem import GraphFit, least_squares_fit
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.solve import solve_pose_graph
from tests.backend.synthetic import unplaced_graph

COUNT = 60
STD = np.array([0.05, 0.05, 0.01])


def eight_twice() -> np.ndarray:
    """Poses (n, 4, 4) of a figure eight, 20 m long, that is flown twice."""
    t = np.linspace(0, 4 * np.pi, COUNT)
    xy = np.column_stack([10 * np.sin(t), 5 * np.sin(2 * t)])
    step = np.gradient(xy, axis=0)
    return se3.from_planar(np.column_stack([xy, np.arctan2(step[:, 1], step[:, 0])]))


def with_false_loops(
    false: np.ndarray, moved: np.ndarray, seed: int, count: int = 20
) -> tuple[PoseGraph, np.ndarray]:
    """The graph of the two laps, and which edges (m,) are false: those loops lead to a moved copy."""
    rng, w_T = np.random.default_rng(seed), eight_twice()
    first = rng.permutation(COUNT // 2)[:count]
    loops = np.column_stack([first, np.minimum(first + 29 + rng.integers(0, 2, count), COUNT - 1)])
    steps = np.column_stack([np.arange(COUNT - 1), np.arange(1, COUNT)])
    i, j = np.concatenate([steps, loops]).T
    is_false = np.concatenate([np.zeros(len(steps), dtype=bool), false])
    ends = w_T[j].copy()
    ends[is_false] = moved @ ends[is_false]
    ij_T = se3.inverse(w_T[i]) @ ends @ se3.from_planar(rng.normal(size=(len(i), 3)) * STD)
    return unplaced_graph(i, j, ij_T, STD), is_false


def shift(length: float) -> np.ndarray:
    return se3.from_planar(np.array([[length, 0.0, 0.0]]))[0]


@pytest.mark.parametrize(("false", "seed"), [(6, 2), (8, 3), (12, 2)])
def test_a_map_of_false_loops_is_not_ok(false: int, seed: int) -> None:
    graph, is_false = with_false_loops(np.arange(20) < false, shift(1.0), seed)
    solution = solve_pose_graph(graph, covariances=False)
    assert solution.status != "ok" or not (solution.edge_kept & is_false).any()


def test_both_sides_and_the_next_step_are_named() -> None:
    graph, _ = with_false_loops(np.arange(20) < 12, shift(1.0), 0)
    solution = solve_pose_graph(graph, covariances=False)
    assert "agree with each other and contradict" in solution.status
    assert "check which of the two are true" in solution.status


@pytest.mark.parametrize(("false", "seed"), [(2, 1), (2, 3), (3, 1), (4, 2)])
def test_a_second_map_of_few_false_loops_is_not_named(
    false: int, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Odometry bends until it fits them, but most loops and the strain are against that map."""
    maps: list[MovedRivals] = []

    def noted(*given: Any) -> list[MovedRivals]:
        found = rival_maps(*given)
        maps.extend(found)
        return found

    monkeypatch.setattr(rival_groups, "rival_maps", noted)
    graph, is_false = with_false_loops(np.arange(20) < false, shift(1.0), seed)
    solution = solve_pose_graph(graph, covariances=False)
    assert len(maps) == 1
    assert solution.status == "ok"
    assert not (solution.edge_kept & is_false).any()


def test_no_second_map_is_solved_out_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time ends when the loops have been chosen: the status is then not ok."""
    graph, _ = with_false_loops(np.arange(20) < 3, shift(1.0), 1)
    search, fits = rival_groups.rival_groups, list[Any]()

    def late(*given: Any) -> list[str]:
        monkeypatch.setattr("time.monotonic", lambda: np.inf)
        return search(*given)

    def noted(*given: Any) -> GraphFit:
        fits.append(given)
        return least_squares_fit(*given)

    monkeypatch.setattr("backend.pose_graph.solve.rival_groups", late)
    monkeypatch.setattr("backend.pose_graph.checks.rival_maps.least_squares_fit", noted)
    solution = solve_pose_graph(graph, covariances=False, time_limit_s=3600.0)
    monkeypatch.undo()
    assert fits == []
    assert "search for a second map of the rejected loops was cut off: allow more time" in solution.status
