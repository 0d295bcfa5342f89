"""The drift of motion by instruments: two-sided consistency, and what pictures cannot show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.drift import Displacement, Drift, DriftModel

Array = NDArray[np.float64]

MODEL = DriftModel(1.0, 0.3, 0.2, 0.003)
STEP_S, STD_M = 0.1, 0.01


def walk(rng: np.random.Generator, count: int) -> Array:
    """Return true departures (count, 2) of a path by the model, in steps of a hundredth of `STEP_S`."""
    fine = 100
    acceleration = rng.normal(0, MODEL.acceleration_std_m_s2, 2) + np.cumsum(
        rng.normal(0, MODEL.acceleration_walk * np.sqrt(STEP_S / fine), (count * fine, 2)), axis=0
    )
    speed = rng.normal(0, MODEL.speed_std_m_s, 2) + np.cumsum(acceleration, axis=0) * STEP_S / fine
    return np.asarray(np.cumsum(speed, axis=0)[::fine] * STEP_S / fine)


def seen(rng: np.random.Generator, moved_m: Array, along_std_m: float = STD_M) -> Displacement:
    std = np.array([STD_M, along_std_m])
    wobble = rng.normal(0, MODEL.place_std_m * np.sqrt(2), 2)
    return Displacement(moved_m + wobble + rng.normal(0, std), np.diag(std**2))


def squared(predicted: Displacement, moved_m: Array) -> float:
    off = predicted.moved_m - moved_m
    return float(off @ np.linalg.solve(predicted.covariance, off))


def test_predictions_depart_from_the_truth_as_much_as_told():
    squares = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        true = walk(rng, 12)
        drift = Drift.begin(MODEL, 0, 0.0)
        for k in range(1, 12):
            drift = drift.at(k * STEP_S)
            if k > 1:
                squares.append(squared(drift.from_keyframe, seen(rng, true[k] - true[0], 0.0).moved_m))
            drift = drift.seen_from_keyframe(seen(rng, true[k] - true[0]))
    assert 1.4 < np.mean(squares) < 2.6


def test_a_direction_that_is_not_seen_grows_uncertain_and_the_other_does_not():
    rng = np.random.default_rng(3)
    true, drift = walk(rng, 31), Drift.begin(MODEL, 0, 0.0)
    for k in range(1, 31):
        along_std_m = STD_M if k < 10 else 10.0
        drift = drift.at(k * STEP_S).seen_from_keyframe(seen(rng, true[k] - true[0], along_std_m))
    std_m = np.sqrt(np.diagonal(drift.at(31 * STEP_S).from_keyframe.covariance))
    assert std_m[0] < 0.03
    assert 0.3 < std_m[1] < 3.0
    assert abs(drift.from_keyframe.moved_m[1] - true[30, 1] + true[0, 1]) < 4 * std_m[1]


def test_a_new_keyframe_keeps_the_rates_and_starts_from_itself():
    rng = np.random.default_rng(5)
    true, drift = walk(rng, 21), Drift.begin(MODEL, 0, 0.0)
    for k in range(1, 20):
        drift = drift.at(k * STEP_S).seen_from_keyframe(seen(rng, true[k] - true[0]))
    rebased = drift.at_keyframe(19).at(20 * STEP_S)
    assert rebased.keyframe == 19
    assert rebased.from_keyframe.moved_m == pytest.approx(rebased.from_before.moved_m)
    assert np.linalg.norm(rebased.from_keyframe.moved_m - true[20] + true[19]) < 0.05
    assert np.sqrt(rebased.from_keyframe.covariance.max()) < 0.03


def test_the_picture_before_ties_this_one_where_the_keyframe_does_not():
    drift = Drift.begin(MODEL, 0, 0.0).at(0.1).seen_from_keyframe(Displacement(np.zeros(2), np.eye(2) * 1e-4))
    later = drift.at(0.5)
    tied = later.seen_from_before(Displacement(np.array([0.02, 0.0]), np.eye(2) * 1e-4))
    assert np.trace(tied.from_keyframe.covariance) < 0.2 * np.trace(later.from_keyframe.covariance)
    assert tied.from_keyframe.moved_m == pytest.approx([0.02, 0.0], abs=0.01)
