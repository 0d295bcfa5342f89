"""Rejected loops that share a displacement are named; loops that are false each in its own way are not."""

from __future__ import annotations

import pytest

from backend.pose_graph.checks.displaced_loops import displaced_loops
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.generated_graphs import SHAPES, MadeGraph, Scene, make
from tests.benchmarks.offset_graphs import OffsetScene, error_ratio, make_offset, offset_scenes


def sentences(made: MadeGraph) -> list[str]:
    solution = solve_pose_graph(made.graph, covariances=False)
    return displaced_loops(from_pose_graph(made.graph), solution)


def test_loops_of_one_displacement_are_named_with_its_size() -> None:
    (sentence,) = sentences(make_offset(OffsetScene("laps", 1, 2, 0.3, 3.0, "mixed", 0)))
    assert "rejected loops" in sentence
    assert "agree with each other" in sentence
    assert " m and " in sentence


def test_random_false_loops_share_nothing() -> None:
    assert sentences(make(Scene("laps", 1, 2, 0.3, "random", 0))) == []


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_healthy_and_random_graphs_share_nothing(shape: str) -> None:
    for share in (0.0, 0.25, 0.5):
        for robots in (1, 2):
            assert sentences(make(Scene(shape, robots, 2, share, "random", 5))) == []


@pytest.mark.slow
def test_few_wrong_maps_are_ok() -> None:
    """Where one offset is common to a third to a half of the loops, a map that it bends is seldom ``ok``."""
    scenes = [s for s in offset_scenes(range(5, 6)) if s.robots < 3 and s.size_m >= 1 and s.share < 0.6]
    # Sparse loops leave the drift of odometry as large as the offset: nothing tells it then.
    scenes = [s for s in scenes if s.where != "tail" and s.poses_per_loop < 4][::4]
    silent = 0
    for scene in scenes:
        made = make_offset(scene)
        solution = solve_pose_graph(made.graph, covariances=False)
        silent += solution.status == "ok" and error_ratio(made, solution) > 1.2
    assert len(scenes) >= 20
    assert silent <= 0.05 * len(scenes)
