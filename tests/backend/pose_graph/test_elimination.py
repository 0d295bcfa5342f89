"""The order of elimination: complete, shallow where it must be, and safe where METIS is not."""

from __future__ import annotations

import subprocess
import sys

import gtsam
import numpy as np
import pytest

from backend.pose_graph.elimination import elimination_exceeds, nested_dissection

UNIT = gtsam.noiseModel.Unit.Create(3)

ALONE = """
import gtsam, numpy as np
from backend.pose_graph.elimination import DEEP_GRAPH
from backend.pose_graph.minimise import minimise
graph, values, unit = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Unit.Create(3)
step = gtsam.Pose2(1, 0, 0)
graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), unit))
for k in range(DEEP_GRAPH):
    values.insert(k, gtsam.Pose2(k, 0.1, 0))
    if k:
        graph.add(gtsam.BetweenFactorPose2(k - 1, k, step, unit))
for k in range(DEEP_GRAPH, DEEP_GRAPH + 500):
    values.insert(k, gtsam.Pose2())
    graph.add(gtsam.PriorFactorPose2(k, gtsam.Pose2(k, 0, 0), unit))
print(minimise(graph, values).error)
"""


def floor(points: int, alone: int) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Points along a line, each tied to the next, and some that are only held."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(points + alone):
        values.insert(k, np.zeros(3))
        graph.add(gtsam.PriorFactorPoint3(k, np.zeros(3), UNIT))
    for k in range(points - 1):
        graph.add(gtsam.BetweenFactorPoint3(k, k + 1, np.ones(3), UNIT))
    return graph, values


def order_of(ordering: gtsam.Ordering) -> list[int]:
    return [ordering.at(k) for k in range(ordering.size())]


@pytest.mark.parametrize("alone", [0, 7])
def test_each_variable_stands_once(alone):
    graph, values = floor(40, alone)
    for kind in (graph, graph.linearize(values)):
        assert sorted(order_of(nested_dissection(kind))) == list(range(40 + alone))


def test_nothing_but_lone_variables():
    graph, _ = floor(1, 4)
    assert order_of(nested_dissection(graph)) == [0, 1, 2, 3, 4]


def test_a_large_graph_with_variables_that_only_a_prior_holds():
    """METIS left to itself writes past its memory here; in a process of its own, since that may end it."""
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-500:]
    assert float(done.stdout) == pytest.approx(0, abs=1e-9)


def test_the_operations_of_a_complete_graph_are_those_of_a_dense_matrix():
    i, j = np.triu_indices(30, 1)
    dense = 3.0**3 * sum(width**2 for width in range(1, 31))
    assert elimination_exceeds(dense - 1, 30, i, j, 3)
    assert not elimination_exceeds(dense, 30, i, j, 3)


def test_the_operations_are_those_of_the_factor_not_of_its_envelope():
    """A star: each leaf is eliminated alone in COLAMD's order, but the envelope of any order is wide."""
    leaves = np.arange(1, 200)
    i = np.zeros_like(leaves)
    star = 6.0**3 * (199 * 2**2 + 1)
    assert not elimination_exceeds(star, 200, i, leaves, 6)
    assert elimination_exceeds(star - 1, 200, i, leaves, 6)
