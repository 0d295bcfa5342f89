"""One step of odometry is wrong, and more than one trusted edge leads over it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from backend import se3
from backend.g2o import read_g2o
from backend.measurements import Measurements, RelativePose
from backend.pose_graph.from_measurements import from_measurements
from backend.pose_graph.selection.doubts import agreement_is_lost, doubtful_odometry, odometry_dispute
from backend.pose_graph.solve import solve, solve_pose_graph
from tests.backend.synthetic import LOOP_STD, ODOMETRY_STD, Made, flight
from tests.slam.faults.made_graph import laps

STEP = 20
"""The pose before the wrong step; with 60 poses, a loop from k to k + 30 leads over it for k up to 20."""
LOOPS = (0, 1, 6, 7, 12, 13, 24, 25, 26, 27)
OVER = np.array([k <= STEP for k in LOOPS])
FEW = ((STEP - 1, STEP + 1), (STEP, STEP + 1))


def _measured(truth: np.ndarray, i: int, j: int, std: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return se3.inverse(truth[i]) @ truth[j] @ se3.exp((rng.normal(size=6) * std)[None])[0]


def _flight_with_a_wrong_step(seed: int, few: bool = True) -> Made:
    """All pictures over the step were registered to a thing that hides the floor: they are 3 m wrong.

    With ``few``, two pairs of pictures lead over it, as where tracking is difficult; else six as everywhere.
    """
    made, rng = flight(seed, loops=0), np.random.default_rng(seed)
    truth, n = made.truth, len(made.truth)
    wrong = se3.exp(np.array([[0, 0, 0, 3.0, 0, 0]]))[0]
    edges: list[RelativePose] = []
    for i, j in [(k, k + a) for a in (1, 2, 3) for k in range(n - a)]:
        T = _measured(truth, i, j, ODOMETRY_STD, rng)
        if i <= STEP < j:
            if few and (i, j) not in FEW:
                continue
            T = se3.inverse(truth[i]) @ truth[STEP] @ wrong @ se3.inverse(truth[STEP]) @ truth[i] @ T
        edges.append(RelativePose(i, j, T, np.diag(ODOMETRY_STD**2), "odometry"))
    for k in LOOPS:
        T = _measured(truth, k, k + 30, LOOP_STD, rng)
        edges.append(RelativePose(k, k + 30, T, np.diag(LOOP_STD**2), "loop"))
    return Made(replace(made.measurements, relative_poses=tuple(edges)), truth)


def _over_the_step(measurements: Measurements) -> np.ndarray:
    return np.array([e.kind == "odometry" and e.i <= STEP < e.j for e in measurements.relative_poses])


def _loops(measurements: Measurements) -> np.ndarray:
    return np.array([e.kind == "loop" for e in measurements.relative_poses])


def test_all_trusted_edges_over_the_wrong_step_lose_their_trust():
    made = _flight_with_a_wrong_step(0)
    problem, _ = from_measurements(made.measurements, None)
    kept = np.ones(len(problem.i), dtype=bool)
    kept[np.flatnonzero(~problem.trusted)[OVER]] = False
    assert np.array_equal(doubtful_odometry(problem, kept), _over_the_step(made.measurements))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_loops_over_a_wrong_step_are_kept_where_several_edges_agree_on_it(seed: int):
    made = _flight_with_a_wrong_step(seed)
    solved = solve(made.measurements, covariances=False)
    assert np.array_equal(~solved.edge_kept, _over_the_step(made.measurements))
    off = np.linalg.norm(solved.w_T_b[:, :3, 3] - made.truth[:, :3, 3], axis=1)
    assert off.max() < 0.3
    assert solved.disputed_odometry == ()


@pytest.mark.parametrize(
    "start",
    [
        "all edges",
        pytest.param("odometry", marks=pytest.mark.slow),
        pytest.param("bent", marks=pytest.mark.slow),
    ],
)
def test_the_initial_guess_does_not_decide(start: str):
    """A guess that follows loops and odometry at once bends both sides of the wrong step."""
    made = _flight_with_a_wrong_step(0)
    measured = made.measurements
    odometry = tuple(e for e in measured.relative_poses if e.kind == "odometry")
    guess = {
        "odometry": lambda: solve(replace(measured, relative_poses=odometry), covariances=False).w_T_b,
        "all edges": lambda: solve(measured, covariances=False, loops_robust=False).w_T_b,
        "bent": lambda: made.truth @ se3.exp(np.linspace(0, 1, 60)[:, None] * [0, 0, 0.5, 3.0, 0, 0]),
    }[start]()
    solved = solve(measured, covariances=False, initial=guess)
    assert np.array_equal(~solved.edge_kept, _over_the_step(measured))


def test_as_many_edges_as_loops_are_believed_but_the_status_says_what_contradicts_them():
    """Six pairs of pictures against six loops: nothing decides, so that no answer is ok."""
    made = _flight_with_a_wrong_step(0, few=False)
    solved = solve(made.measurements, covariances=False)
    assert np.array_equal(~solved.edge_kept[_loops(made.measurements)], OVER)
    (said,) = solved.disputed_odometry
    assert "6 loops agree with each other and contradict the odometry from keyframe" in said
    assert "look there, and leave out what is blurred" in said
    assert said in solved.status


def test_false_loops_between_one_pair_of_places_contradict_nothing():
    made = _flight_with_a_wrong_step(0)
    problem, _ = from_measurements(made.measurements, None)
    step = _over_the_step(made.measurements)
    row = (problem.i < 2) & ~problem.trusted
    assert np.count_nonzero(row) == 2
    assert odometry_dispute(problem, step, row) == ""
    assert odometry_dispute(problem, step, ~problem.trusted).startswith("10 loops agree with each other")


def test_agreement_with_odometry_is_lost_unless_the_gate_explains_it():
    """Ten loops agreed: the gate rejects one of them once in a hundred graphs, two once in 20 000."""
    number = np.arange(10)
    agreeing = np.ones(10, dtype=bool)
    assert not agreement_is_lost(agreeing, number != 1)
    assert agreement_is_lost(agreeing, (number != 1) & (number != 2))


@pytest.mark.slow
@pytest.mark.parametrize("ahead", [5, 12, 20])
def test_false_loops_in_a_row_outvote_neither_odometry_nor_true_loops(tmp_path: Path, ahead: int):
    """A long row of loops to a place some poses ahead, as where a floor repeats: it counts once."""
    laps(tmp_path / "laps.g2o")
    made = read_g2o(tmp_path / "laps.g2o")
    row = np.flatnonzero(~made.is_odometry)[18:36]
    made.i[row] += ahead
    solved = solve_pose_graph(made, covariances=False)
    assert np.array_equal(np.flatnonzero(~solved.edge_kept), row)
