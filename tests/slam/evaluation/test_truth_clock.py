"""A truth whose clock is late or early is told, and one that is right is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.streams import Truth
from slam.evaluation import evaluate
from slam.report.tables.evaluation import evaluated
from tests.slam.evaluation.scene import disturbed, estimate_of, flight_of, smooth_poses


def evaluation(late_s: float):
    rng = np.random.default_rng(3)
    poses = smooth_poses(rng, 1200)
    flight = flight_of(poses, truth=Truth(np.arange(1200) * 0.02 + late_s, poses))
    return evaluate(estimate_of(disturbed(rng, poses[100:1100:12], np.full(6, 1e-3)), 0.24), flight)


@pytest.mark.parametrize("late_s", [-2.3, -1.7])
def test_a_shifted_clock_is_told_with_its_shift(late_s):
    """The keyframes begin 2 s after the rows of the truth: the clock is late by ``late_s`` + 2 s."""
    found = evaluation(late_s)
    assert found.truth_clock is not None
    assert found.truth_clock.late_s == pytest.approx(late_s + 2, abs=0.01)
    assert found.truth_clock.ate_aligned_m < found.ate_aligned_m.rmse / 2
    assert found.to_json()["truth_clock"]["late_s"] == found.truth_clock.late_s
    told = evaluated(found)
    assert f"s {'late' if late_s > -2 else 'early'}" in told.words


def test_a_right_clock_is_not_doubted():
    found = evaluation(-2.0)
    assert found.truth_clock is None
    assert "stamps look" not in evaluated(found).words


def test_keyframes_at_the_end_that_are_wrong_are_no_sign_of_the_clock() -> None:
    """A shift that moves them beyond the truth leaves the others, which always fitted."""
    poses = np.tile(np.eye(4), (80, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(80)
    wrong = poses.copy()
    wrong[-6:, 1, 3] += np.linspace(0.05, 0.5, 6)
    wrong[:, 2, 3] += np.random.default_rng(1).normal(0.0, 0.005, 80)
    estimate = estimate_of(wrong)
    assert evaluate(estimate, flight_of(poses, truth=Truth(estimate.stamps_s, poses))).truth_clock is None


def test_rows_out_of_order_tell_the_shift_too() -> None:
    rng = np.random.default_rng(3)
    poses, order = smooth_poses(rng, 1200), np.random.default_rng(1).permutation(1200)
    truth = Truth((np.arange(1200) * 0.02 - 1.7)[order], poses[order])
    found = evaluate(
        estimate_of(disturbed(rng, poses[100:1100:12], np.full(6, 1e-3)), 0.24), flight_of(poses, truth=truth)
    )
    assert found.truth_clock is not None
    assert found.truth_clock.late_s == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("count", [1, 2])
def test_an_alignment_that_makes_all_keyframes_fit_leaves_no_error(count):
    poses = smooth_poses(np.random.default_rng(4), 40)
    estimate, flight = estimate_of(poses), flight_of(poses)
    assert flight.truth is not None
    truth = Truth(flight.truth.stamps_s[:count], flight.truth.w_T_b[:count])
    found = evaluate(estimate, replace(flight, truth=truth))
    assert found.associated == count
    assert np.isnan(found.ate_m.rmse) == (count == 1)
    assert np.isnan([found.ate_aligned_m.rmse, found.ate_sim3_m.rmse, found.scale]).all()
    text = " ".join(" ".join(row) for table in evaluated(found).tables for row in table.rows)
    assert "nan" not in text


def test_a_truth_that_stands_still_has_no_scale():
    poses = smooth_poses(np.random.default_rng(5), 40)
    still = np.tile(poses[0], (400, 1, 1))
    found = evaluate(estimate_of(poses), flight_of(poses, truth=Truth(np.arange(400) * 0.025, still)))
    assert np.isnan(found.scale)
    assert np.isnan(found.ate_sim3_m.rmse)
    assert all(np.isnan(step.translation_percent) for step in found.rpe)
