"""Loop precision and recall on geometry that can be checked by hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from slam.core.estimate import LoopVerdict
from slam.evaluation import evaluate
from slam.evaluation.loop_score import overlap_share, pair_overlaps, score_loops
from tests.slam.evaluation.scene import CAMERA, estimate_of, flight_of, smooth_poses

SQUARE = Camera((100.0, 100.0), (50.0, 50.0), (101, 101))
"""One metre up it shows a square metre."""


def above(*places):
    """Level keyframes one metre up at (x, y)."""
    w_T_b = np.tile(np.eye(4), (len(places), 1, 1))
    w_T_b[:, :2, 3], w_T_b[:, 2, 3] = places, 1.0
    return w_T_b


def kept(*pairs):
    return tuple(LoopVerdict(i, j, None) for i, j in pairs)


def scored(loops, stamps_s, poses, keyframe=None):
    keyframe = np.arange(len(poses)) if keyframe is None else keyframe
    return score_loops(loops, np.asarray(stamps_s, dtype=float), keyframe, poses, SQUARE)


@pytest.mark.parametrize("offset_m", [0.0, 1e6])
def test_the_share_of_two_squares_is_the_hand_computed_one(offset_m):
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) + offset_m
    turn = np.array([[np.cos(np.pi / 4), -np.sin(np.pi / 4)], [np.sin(np.pi / 4), np.cos(np.pi / 4)]])
    diamond = (square - square.mean(axis=0)) @ turn.T + square.mean(axis=0)
    assert overlap_share(square, square + [0.25, 0.0]) == pytest.approx(0.75, abs=1e-6)
    assert overlap_share(square, square[::-1] + [0.5, 0.5]) == pytest.approx(0.25, abs=1e-6)
    assert overlap_share(square, diamond) == pytest.approx(2 * (np.sqrt(2) - 1), abs=1e-6)
    assert overlap_share(square, square + [1.5, 0]) == 0
    inner = 0.2 * (square - square.mean(axis=0)) + square.mean(axis=0)
    assert overlap_share(square, inner) == overlap_share(inner, square) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_shares_agree_with_counting_points(seed):
    rng = np.random.default_rng(seed)
    footprints = np.stack([CAMERA.footprint(pose) for pose in smooth_poses(rng, 2, size_m=0.1)])
    low, high = footprints.min(axis=(0, 1)), footprints.max(axis=(0, 1))
    points = rng.uniform(low, high, size=(40_000, 2))
    inside = [
        np.array([cv2.pointPolygonTest(quad.astype(np.float32), p, False) >= 0 for p in points.tolist()])
        for quad in footprints
    ]
    counted = (inside[0] & inside[1]).sum() / min(inside[0].sum(), inside[1].sum())
    assert overlap_share(*footprints) == pytest.approx(counted, abs=0.02)


def test_true_false_and_undecided_loops():
    poses = above((0, 0), (5, 0), (0.1, 0), (0.8, 0), (9, 0), (0.05, 0))
    stamps_s = [0, 8, 20, 40, 60, 5]
    found = scored(kept((0, 2), (0, 3), (0, 4), (0, 5)), stamps_s, poses)
    # 0-2 shares 0.9; 0-3 shares 0.2: undecided; 0-4 shares nothing; 0-5 lie 5 s apart: not looked at.
    assert (found.true_kept, found.undecided_kept, found.false_kept) == (1, 1, 1)
    assert found.precision == pytest.approx(1 / 2)
    # True pairs: 0-2, 5-2 (0.95), 2-3 (0.3).
    assert found.true_pairs == 3
    assert found.recall == pytest.approx(1 / 3)
    assert found.keyframe_recall == pytest.approx(2 / 4)


def test_the_thresholds_are_ten_and_thirty_percent():
    for place, true, undecided in ((0.69, 1, 0), (0.71, 0, 1), (0.89, 0, 1), (0.91, 0, 0)):
        found = scored(kept((0, 1)), [0, 10], above((0, 0), (place, 0)))
        assert (found.true_kept, found.undecided_kept, found.false_kept) == (
            true,
            undecided,
            1 - true - undecided,
        )


def test_ten_seconds_apart_and_no_less():
    assert scored((), [0, 10], above((0, 0), (0, 0))).true_pairs == 1
    assert scored((), [0, 9.99], above((0, 0), (0, 0))).true_pairs == 0


def test_rejected_loops_do_not_count_and_the_order_of_a_pair_does_not_matter():
    poses = above((0, 0), (0.1, 0), (7, 0))
    loops = (LoopVerdict(0, 2, Rejection(LinkCheck.TOO_FEW_INLIERS)), LoopVerdict(1, 0, None))
    found = scored(loops, [0, 20, 40], poses)
    assert (found.precision, found.recall) == (1.0, 1.0)


def test_nothing_to_count_is_nan_and_then_null():
    poses = above((0, 0), (5, 0))
    found = scored((), [0, 20], poses)
    assert np.isnan(found.precision)
    assert np.isnan(found.recall)
    record = evaluate(estimate_of(poses, 20.0), flight_of(poses, 20.0, camera=SQUARE)).to_json()
    assert record["loops"]["precision"] is None
    assert record["loops"]["recall"] is None


def test_keyframes_without_truth_or_with_the_horizon_in_view_count_neither_way():
    poses = above((0, 0), (0.1, 0), (0.2, 0))
    poses[2, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    found = score_loops(kept((0, 3), (0, 2)), np.arange(4) * 20.0, np.array([0, 1, 2]), poses, SQUARE)
    assert (found.true_kept, found.false_kept, found.undecided_kept) == (0, 0, 2)
    assert found.true_pairs == 1


@pytest.mark.parametrize("seed", range(3))
def test_the_filter_by_distance_loses_no_pair(seed):
    rng = np.random.default_rng(seed)
    footprints = np.stack([CAMERA.footprint(pose) for pose in smooth_poses(rng, 40, size_m=0.6)])
    stamps_s = np.arange(40) * 1.5
    found = pair_overlaps(footprints, stamps_s)
    for a in range(40):
        for b in range(a + 1, 40):
            share = overlap_share(footprints[a], footprints[b]) if stamps_s[b] - stamps_s[a] >= 10 else 0.0
            assert found.get((a, b), 0.0) == share
