"""What is taken back after the selection, and how two selections are compared."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.gauge_fixed_problem import GaugeFixedProblem, GraphFit, Options
from backend.pose_graph.problem import from_pose_graph
from backend.pose_graph.selection.reasons import reasons
from backend.pose_graph.selection.rejection import _refit, thinned
from backend.pose_graph.selection.selected import Selection
from backend.pose_graph.unary_factors import fixed
from tests.backend.synthetic import flight
from tests.benchmarks.generated_graphs import STD, Scene, make


def test_loops_that_fit_wide_covariances_alone_are_not_taken_back():
    """Deviations are stated eight times too large: a loop eleven true ones off is within its stated gate."""
    made = make(Scene("laps", 1, 1, 0.0, "random", 0))
    bad = np.flatnonzero(~made.odometry)[::3]
    ij_T = made.graph.ij_T.copy()
    ij_T[bad, 0, 3] += 11 * STD[0]
    problem = from_pose_graph(replace(made.graph, ij_T=ij_T, information=made.graph.information / 64))
    priors = gtsam.NonlinearFactorGraph()
    priors.push_back(fixed(0, made.w_T[0], 2).factor)
    without = np.ones(len(problem.i), dtype=bool)
    without[bad] = False
    found = _refit(GaugeFixedProblem(problem, priors, Options()), without, made.w_T, ~problem.trusted)
    assert np.array_equal(found.kept, without)


def test_a_row_of_loops_that_only_one_selection_has_counts_once():
    """False loops of a row agree with each other as true ones do: they are one piece of evidence."""
    made = flight(0, n=60, loops=0, attitude_std=None, range_std=None)
    edges = list(made.measurements.relative_poses)
    for i, j in [(k, k + 30) for k in range(10)] + [(k, k + 15) for k in range(40, 43)]:
        edges.append(replace(edges[0], i=i, j=j, kind="loop"))
    problem, _ = from_measurements(replace(made.measurements, relative_poses=tuple(edges)), made.truth)
    loops, every = np.flatnonzero(~problem.trusted), np.ones(len(problem.i), dtype=bool)
    fit = GraphFit(minimum=None, w_T=made.truth, test=None)  # type: ignore[arg-type]
    nearest = loops[np.argmin(np.linalg.norm(problem.residuals(made.truth)[loops[:10]], axis=1))]

    def left_out(beside: np.ndarray) -> np.ndarray:
        one, other = (Selection(kept, fit, np.zeros(len(kept))) for kept in (every, beside))
        return np.setdiff1d(loops, np.flatnonzero(thinned(problem, one, other).kept))

    without_row = ~np.isin(np.arange(len(every)), loops[:10])
    np.testing.assert_array_equal(left_out(without_row), np.setdiff1d(loops[:10], nearest))
    without_row[loops[3]] = True
    assert len(left_out(without_row)) == 0


def test_a_reason_says_by_whose_deviations_an_edge_was_judged():
    problem = from_pose_graph(make(Scene("laps", 1, 1, 0.0, "random", 0)).graph)
    kept, sigma = np.ones(len(problem.i), dtype=bool), np.zeros(len(problem.i))
    kept[-2:], sigma[-2:] = False, (9.0, 0.5)
    w_T = np.tile(np.eye(4), (problem.count, 1, 1))
    stated, own = (
        [str(reason) for reason in reasons(problem, kept, w_T, sigma, noise)[-2:]] for noise in (1.0, 0.125)
    )
    assert stated[0].startswith("disagrees by 9.0 sigma (limit ")
    assert stated[1].endswith(": 0.5 sigma")
    assert own[0].startswith("disagrees by 9.0 sigma (each 0.12 of a stated one, as the loops show; limit ")
    assert own[1].endswith(": 0.5 sigma (each 0.12 of a stated one, as the loops show)")
