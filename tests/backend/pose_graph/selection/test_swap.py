"""Loops that change sides: the updates against dense algebra, and a map bent by false ones set right."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from backend import se3
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.linear import jacobian
from backend.pose_graph.minimise import minimise
from backend.pose_graph.problem import Problem, from_pose_graph
from backend.pose_graph.selection.evidence import LinearizedSet
from backend.pose_graph.selection.prediction import log_prior_volume
from backend.pose_graph.selection.swap import swap_loops
from backend.pose_graph.selection.swap_search import SwapSearch
from backend.pose_graph.unary_factors import fixed
from tests.backend.synthetic import LOOP_STD, flight, graph


def factors(problem: Problem, kept: np.ndarray) -> gtsam.NonlinearFactorGraph:
    held = problem.with_edges(kept).edge_factors()
    held.push_back(fixed(0, problem.initial[0], problem.dimension).factor)
    return held


def solved(problem: Problem, kept: np.ndarray, w_T: np.ndarray) -> np.ndarray:
    return problem.poses(
        minimise(factors(problem, kept), problem.values(w_T), relative_tolerance=1e-12).values
    )


def linearized(problem: Problem, kept: np.ndarray, w_T: np.ndarray) -> LinearizedSet:
    found = LinearizedSet.of(
        problem, lambda some: factors(problem, some), kept, w_T, log_prior_volume(problem, w_T)
    )
    assert found is not None
    return found


def with_loops(dimension: int) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A graph, its loops, and a solution of all but two of them."""
    problem = from_pose_graph(graph(2, dimension, n=24))
    loops = np.flatnonzero(np.abs(problem.i - problem.j) != 1)
    problem = replace(problem, trusted=np.abs(problem.i - problem.j) == 1)
    kept = np.ones(len(problem.i), dtype=bool)
    kept[loops[:2]] = False
    return problem, loops, solved(problem, kept, problem.initial)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_loop_that_changes_sides_moves_the_others_as_dense_algebra_says(dimension: int):
    problem, loops, w_T = with_loops(dimension)
    d, kept = problem.dof, np.ones(len(problem.i), dtype=bool)
    kept[loops[:2]] = False
    search = SwapSearch(linearized(problem, kept, w_T), loops, problem.residuals(w_T))
    J = jacobian(factors(problem, np.ones_like(kept)), problem.values(w_T)).toarray()
    error = np.append(problem.residuals(w_T).ravel(), np.zeros(len(J) - d * len(kept)))
    for flip in (0, len(loops) - 1, 3, 1, 0):
        search.flip(flip)
        kept[loops[flip]] = ~kept[loops[flip]]
        used = np.append(np.repeat(kept, d), np.ones(len(J) - d * len(kept), dtype=bool))
        covariance = np.linalg.inv(J[used].T @ J[used])
        moved = error - J @ covariance @ J[used].T @ error[used]
        for k, loop in enumerate(loops):
            rows = slice(d * loop, d * loop + d)
            np.testing.assert_allclose(search.residual[k], moved[rows], atol=1e-6)
            np.testing.assert_allclose(search.covariances[k], J[rows] @ covariance @ J[rows].T, atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_gain_of_a_change_is_that_of_the_evidence(dimension: int):
    """In the linear system: what one loop is likely by all others is what the whole gains by it."""
    problem, loops, w_T = with_loops(dimension)
    kept = np.ones(len(problem.i), dtype=bool)
    kept[loops[:2]] = False
    current = linearized(problem, kept, w_T)
    search = SwapSearch(current, loops, problem.residuals(w_T))
    for flip in (0, 5):
        other = kept.copy()
        other[loops[flip]] = ~other[loops[flip]]
        proposal = linearized(problem, other, solved(problem, other, w_T))
        proposal = replace(proposal, scale=current.scale)
        gained = proposal.evidence(current.odds) - current.evidence(current.odds)
        sign = 1 if other[loops[flip]] else -1
        assert sign * search.log_odds()[flip] == pytest.approx(gained, abs=0.3)


@pytest.mark.parametrize("seed", range(3))
def test_false_loops_that_hold_each_other_up_give_way_to_more_true_ones(seed: int):
    """Three false loops far from each other tell the same wrong tale; who begins with them finds out."""
    made = flight(seed, n=120, loops=0, attitude_std=None, range_std=None)
    rng = np.random.default_rng(seed)
    tale = se3.exp(np.array([[0.0, 0.0, 0.2, 0.8, -0.6, 0.0]]))[0]
    edges, false = list(made.measurements.relative_poses), []
    for k, wrong in [(k, k % 16 == 4) for k in range(0, 52, 4)]:
        noise = se3.exp((rng.normal(size=6) * LOOP_STD)[None])[0]
        start = tale @ made.truth[k] if wrong else made.truth[k]
        i_T_j = se3.inverse(start) @ made.truth[k + 60] @ noise
        edges.append(
            replace(edges[0], i=k, j=k + 60, i_T_j=i_T_j, covariance=np.diag(LOOP_STD**2), kind="loop")
        )
        false.append(wrong)
    problem, _ = from_measurements(replace(made.measurements, relative_poses=tuple(edges)), made.truth)
    wrong = np.append(np.zeros(119, dtype=bool), false)
    begun = problem.trusted | wrong
    kept, w_T = swap_loops(
        problem,
        lambda some: factors(problem, some),
        lambda some, at: solved(problem, some, at),
        begun,
        solved(problem, begun, made.truth),
        lambda: False,
    )
    np.testing.assert_array_equal(kept, ~wrong)
    assert np.linalg.norm(w_T[:, :3, 3] - made.truth[:, :3, 3], axis=1).max() < 0.3


def test_a_set_that_explains_all_stays_as_it_is():
    problem = with_loops(3)[0]
    kept = np.ones(len(problem.i), dtype=bool)
    w_T = solved(problem, kept, problem.initial)
    found, at = swap_loops(
        problem,
        lambda some: factors(problem, some),
        lambda some, at: solved(problem, some, at),
        kept,
        w_T,
        lambda: False,
    )
    assert found.all()
    np.testing.assert_array_equal(at, w_T)
