"""The growth of a consistent set, from odometry or from a set that is known."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, Options
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.growth import grow_from_odometry
from backend.pose_graph.unary_factors import fixed
from tests.benchmarks.generated_graphs import Scene, make


@pytest.mark.parametrize("without_a_step", [False, True])
def test_a_growth_that_begins_with_a_known_set_finds_the_same_one_in_fewer_rounds(without_a_step: bool):
    """Without one step of odometry, the loops beside it are known, and those over it are grown."""
    made = make(Scene("laps", 1, 2, 0.3, "random", 0))
    problem, rounds = from_pose_graph(made.graph), []
    priors = gtsam.NonlinearFactorGraph()
    priors.push_back(fixed(0, made.w_T[0], 2).factor)
    options = Options(on_step=lambda number, accepted: rounds.append(accepted))
    known = grow_from_odometry(GaugeFixedProblem(problem, priors, options))
    from_odometry = len(rounds)
    if without_a_step:
        early = np.flatnonzero(problem.trusted)[4]
        problem = replace(problem, trusted=problem.trusted & (np.arange(len(problem.i)) != early))
    again = grow_from_odometry(GaugeFixedProblem(problem, priors, options), known)
    np.testing.assert_array_equal(again.kept, known.kept)
    assert not (again.kept & made.false).any()
    assert len(rounds) - from_odometry <= from_odometry / 2
