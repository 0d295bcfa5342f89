"""Two groups of loops that exclude each other are named where neither has high odds."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.checks.rival_groups import _minimum_cut
from backend.pose_graph.graph import PoseGraph
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.generated_graphs import SHAPES, STD, Scene, make
from tests.benchmarks.offset_graphs import OffsetScene, make_offset

STEP = se3.from_planar(np.array([[1.0, 0.0, 0.0]]))[0]


def status(graph: PoseGraph) -> str:
    return solve_pose_graph(graph, covariances=False).status


def two_robots(right: list[int], wrong: list[int], length: int = 80) -> PoseGraph:
    """Two robots side by side on straight lines; some loops between them put the second one 3 m ahead."""
    rng = np.random.default_rng(0)
    line = se3.from_planar(np.column_stack([np.arange(length), np.zeros((length, 2))]))
    w_T = np.concatenate([line, line @ se3.from_planar(np.array([[0.0, 0.5, 0.0]]))[0]])
    steps = [(k, k + 1) for k in range(2 * length - 1) if k != length - 1]
    pairs = np.array([*steps, *((k, k + length) for k in right), *((k, k + length) for k in wrong)])
    noise = se3.from_planar(rng.normal(size=(len(pairs), 3)) * STD * [0.2, 0.2, 0.02])
    ij_T = se3.inverse(w_T[pairs[:, 0]]) @ w_T[pairs[:, 1]] @ noise
    ahead = se3.from_planar(np.array([[3.0, 0.0, 0.0]]))[0]
    ij_T[len(pairs) - len(wrong) :] = ahead @ ij_T[len(pairs) - len(wrong) :]
    return PoseGraph(
        dimension=2,
        ids=np.arange(2 * length) + 1000 * (np.arange(2 * length) >= length),
        poses=w_T,
        i=pairs[:, 0],
        j=pairs[:, 1],
        ij_T=ij_T,
        information=np.tile(np.diag((STD * [0.2, 0.2, 0.02]) ** -2.0), (len(pairs), 1, 1)),
        fixed=np.zeros(2 * length, dtype=bool),
    )


def test_as_many_loops_for_either_place_are_named_with_both_groups():
    said = status(two_robots([0, 21, 42, 63], [10, 31, 52, 73]))
    assert "4 rejected edges (from vertex" in said
    assert "agree with each other and contradict 4 kept loops (from vertex" in said
    assert "lie 3 m and" in said
    assert "odds for the kept ones are only 1 to 1" in said


def test_many_loops_against_one_are_ok():
    assert status(two_robots([0, 11, 22, 33, 44, 55, 66], [50])) == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_loops_against_unchecked_odometry_are_named(count: int):
    """They place a tail of the path elsewhere, and agree; no other loop spans the odometry to it."""
    made = make(Scene("laps", 1, 1, 0.0, "random", 1)).graph
    kept = made.is_odometry | (np.maximum(made.i, made.j) < 90)
    far = se3.from_planar(np.array([[4.0, 0.0, 0.5]]))[0]
    truth = solve_pose_graph(made, covariances=False).w_T_b

    i, j = np.array([(10, 100), (35, 118), (60, 109)])[:count].T
    graph = replace(
        made,
        i=np.append(made.i[kept], i),
        j=np.append(made.j[kept], j),
        ij_T=np.concatenate([made.ij_T[kept], se3.inverse(truth[i]) @ far @ truth[j]]),
        information=np.concatenate([made.information[kept], made.information[:count]]),
    )
    assert "the odds for the kept ones are only" in status(graph)


@pytest.mark.parametrize("shape", SHAPES)
def test_true_loops_have_no_rivals(shape: str):
    assert status(make(Scene(shape, 2, 2, 0.0, "random", 3)).graph) == "ok"


@pytest.mark.slow
def test_half_of_the_loops_with_one_offset_are_told():
    made = make_offset(OffsetScene("laps", 2, 4, 0.5, 1.0, "mixed", 7))
    assert "rejected edges (from" in status(made.graph)


def test_the_cut_is_the_cheapest_of_all():
    """Against all ways to part six poses, where a row costs its value once."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        ends = np.array([rng.choice(6, 2, replace=False) for _ in range(9)])
        low, high = ends.min(axis=1), ends.max(axis=1)
        # The rows of one loop and more; those of more lie apart, so that their bottleneck is exact.
        row = np.arange(9)
        value = rng.uniform(1, 10, size=9)
        cut = _minimum_cut(6, low, high, row, value, np.array([0]), np.array([5]))
        costs = []
        for side in product((False, True), repeat=4):
            inside = np.array([True, *side, False])
            costs.append(value[inside[low] != inside[high]].sum())
        assert value[cut].sum() == pytest.approx(min(costs), abs=0.01)


def test_a_row_is_cut_at_its_value_whatever_its_length():
    """Two ways from 0 to 5: three loops of one row, or two edges in parallel."""
    low, high = np.array([0, 0, 0, 1, 2]), np.array([3, 3, 3, 5, 5])
    low, high = np.append(low, [0, 0, 3]), np.append(high, [1, 2, 5])
    row = np.array([0, 0, 0, 1, 2, 3, 4, 5])
    value = np.array([2.0, 3.0, 4.0, 9.0, 9.0, 9.0])
    cut = _minimum_cut(6, low, high, row, value, np.array([0]), np.array([5]))
    assert np.flatnonzero(cut).tolist() == [0, 1, 2, 3, 4]
