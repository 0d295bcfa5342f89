"""Whether rejected loops over a step of odometry agree with each other better than kept ones do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, Options, least_squares_fit
from backend.pose_graph.problem import Problem, from_pose_graph
from backend.pose_graph.selection.step_support import may_be_wrong
from backend.pose_graph.unary_factors import fixed
from tests.benchmarks.selection_matrix import Scene, make

STEP = 60


def _better(problem: Problem, kept: np.ndarray, w_T: np.ndarray) -> bool:
    problem = replace(problem, unary_factors=(fixed(0, w_T[0], 2),))
    gauge_fixed = GaugeFixedProblem(problem, problem.unary_factor_graph(), Options())
    step = problem.trusted & (np.minimum(problem.i, problem.j) == STEP)
    w_T = least_squares_fit(gauge_fixed, kept, w_T).w_T
    return may_be_wrong(gauge_fixed, step, kept, w_T)


def _over(problem: Problem) -> np.ndarray:
    low, high = np.minimum(problem.i, problem.j), np.maximum(problem.i, problem.j)
    return ~problem.trusted & (low <= STEP) & (high > STEP)


@pytest.mark.parametrize("number", [1, 2])
def test_false_loops_over_a_right_step_agree_less_than_the_true_ones(number: int):
    """The false loops over the step are more than the true ones."""
    made = make(Scene("laps", 1, number, 0.6, "random", 3))
    problem = from_pose_graph(made.graph)
    over = _over(problem)
    assert (made.false & over).sum() > (~made.false & over).sum() > 2
    assert not _better(problem, ~made.false, made.w_T)


def test_true_loops_over_a_wrong_step_agree_better_than_those_that_were_kept():
    """All true loops over the step were rejected, and so were the false ones."""
    made = make(Scene("laps", 1, 2, 0.25, "random", 3))
    ij_T = made.graph.ij_T.copy()
    step = np.flatnonzero((made.graph.i == STEP) & (made.graph.j == STEP + 1))
    ij_T[step] = ij_T[step] @ se3.from_planar(np.array([[3.0, 0.0, 0.5]]))
    problem = from_pose_graph(replace(made.graph, ij_T=ij_T))
    assert _better(problem, ~made.false & ~_over(problem), made.w_T)
