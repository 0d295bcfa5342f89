"""Precision and recall against figures worked out by hand and against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from slam.evaluation.loops.curve import precision_recall


def test_five_pairs_by_hand():
    """Right, wrong, right, right, wrong; a fourth loop has no score at all."""
    score = np.array([0.2, 0.9, 0.8, 0.5, 0.6])
    curve = precision_recall(score, np.array([False, True, False, True, True]), 4)
    np.testing.assert_allclose(curve.threshold, [0.9, 0.8, 0.6, 0.5, 0.2])
    np.testing.assert_allclose(curve.precision, [1, 1 / 2, 2 / 3, 3 / 4, 3 / 5])
    np.testing.assert_allclose(curve.recall, [1 / 4, 1 / 4, 2 / 4, 3 / 4, 3 / 4])
    assert curve.area == pytest.approx(0.25 * (1 + 2 / 3 + 3 / 4))
    assert curve.full_precision_recall == 0.25


def test_equal_scores_stand_or_fall_together():
    """However the rows are ordered, a false pair as good as the best true one leaves no full precision."""
    for is_true in ([True, False, True], [False, True, True]):
        curve = precision_recall(np.array([0.7, 0.7, 0.1]), np.array(is_true), 2)
        np.testing.assert_allclose(curve.precision, [1 / 2, 2 / 3])
        assert curve.full_precision_recall == 0.0
        assert curve.area == pytest.approx(0.5 * (1 / 2 + 2 / 3))


@pytest.mark.parametrize("seed", range(5))
def test_every_point_agrees_with_counting(seed):
    rng = np.random.default_rng(seed)
    score, is_true = rng.integers(0, 12, 60) / 7, rng.random(60) < 0.3
    total = int(is_true.sum()) + 3
    curve = precision_recall(score, is_true, total)
    assert (np.diff(curve.threshold) < 0).all()
    assert set(curve.threshold) == set(score)
    for threshold, precision, recall in zip(curve.threshold, curve.precision, curve.recall, strict=True):
        taken = score >= threshold
        assert precision == pytest.approx((taken & is_true).sum() / taken.sum())
        assert recall == pytest.approx((taken & is_true).sum() / total)
    assert 0 < curve.area < 1
    thin = curve.thinned(5)
    assert len(thin.recall) <= 5
    assert (thin.recall[0], thin.recall[-1]) == (curve.recall[0], curve.recall[-1])


def test_chance_is_the_share_of_true_ones_and_perfect_is_one():
    rng = np.random.default_rng(0)
    is_true = np.arange(20_000) % 5 == 0
    assert precision_recall(rng.random(20_000), is_true, 4000).area == pytest.approx(0.2, abs=0.02)
    assert precision_recall(is_true.astype(float), is_true, 4000).area == 1.0
    assert precision_recall(is_true.astype(float), is_true, 8000).area == 0.5


def test_without_a_true_pair_there_is_no_recall_and_without_a_score_there_is_none_found():
    curve = precision_recall(np.array([0.3, 0.2]), np.zeros(2, bool), 0)
    assert np.isnan(curve.area)
    assert np.isnan(curve.full_precision_recall)
    nothing = precision_recall(np.empty(0), np.empty(0, bool), 4)
    assert (nothing.area, nothing.full_precision_recall) == (0.0, 0.0)
    assert len(nothing.thinned(10).recall) == 0
