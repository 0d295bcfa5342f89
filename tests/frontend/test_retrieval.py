"""Retrieval: pictures of one place rank above pictures of others."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.features import FeatureKind
from frontend.loops import propose_loops
from frontend.retrieval import (
    RetrievalConfig,
    as_float,
    compressed,
    principal_components,
    propose,
    signature,
    vocabulary,
)
from frontend.store import FeatureStore
from tests.frontend.small_flight import features_of, small_flight, true_overlaps

STEP = 3


def look_alikes(store: FeatureStore, config: RetrievalConfig) -> list[tuple[int, int]]:
    """With a gate that lets everything pass."""
    return list(propose_loops(store, config, lambda _, rows: np.ones(len(rows), bool)).pairs)


def filled(kind: FeatureKind) -> FeatureStore:
    store = FeatureStore()
    for features in features_of(kind, STEP):
        store.append(features)
    return store


@pytest.mark.parametrize(
    ("kind", "recall_band"),
    [("sift", (0.85, 0.98)), pytest.param("orb", (0.78, 0.95), marks=pytest.mark.slow)],
)
def test_overlapping_pictures_rank_above_others(kind: FeatureKind, recall_band: tuple[float, float]) -> None:
    """How many pairs of different laps that overlap by half are among the candidates, beside chance."""
    flight, store = small_flight(), filled(kind)
    n = len(store)
    stamps_s, overlap = flight.stamps_s[::STEP], true_overlaps(STEP)
    true = {(int(i), int(j)) for i, j in np.argwhere(overlap > 0.5) if stamps_s[j] - stamps_s[i] > 5}
    assert len(true) > 20
    config = RetrievalConfig(words=32, sample=6000, neighbours=8)
    pairs = look_alikes(store, config)
    assert len(pairs) == len(set(pairs))
    assert all(i < j for i, j in pairs)
    recall = len(true & set(pairs)) / len(true)
    chance = 2 * len(pairs) / (n * (n - 1))
    assert recall_band[0] <= recall <= recall_band[1]
    assert chance < 0.4
    # The most alike come first: the first quarter overlaps more than the last.
    quarter = len(pairs) // 4
    shares = np.array([overlap[pair] for pair in pairs])
    assert shares[:quarter].mean() > shares[-quarter:].mean() + 0.2
    assert look_alikes(store, config) == pairs


def test_vocabulary_is_deterministic_sampled_and_sized_to_what_there_is() -> None:
    rng = np.random.default_rng(0)
    descriptors = [rng.normal(size=(300, 16)).astype(np.float32) for _ in range(4)]
    config = RetrievalConfig(words=32, sample=500)

    def words(of: list[np.ndarray], seed: int = 0) -> np.ndarray:
        return vocabulary(iter(of), [len(d) for d in of], config, seed)

    np.testing.assert_array_equal(words(descriptors, 4), words(descriptors, 4))
    assert words(descriptors, 4).shape == (32, 16)
    assert not np.array_equal(words(descriptors, 4), words(descriptors, 5))
    assert words([descriptors[0][:40]]).shape == (5, 16)
    assert words([descriptors[0][:3], descriptors[0][:0]]).shape == (1, 16)


def test_vocabulary_is_of_rows_of_all_pictures_drawn_alike() -> None:
    """Each picture's descriptors are one point: each point that is drawn often becomes a word."""
    descriptors = [np.full((count, 4), float(k), np.float32) for k, count in enumerate((400, 0, 800, 400))]
    config = RetrievalConfig(words=3, sample=200)
    centres = vocabulary(iter(descriptors), [len(d) for d in descriptors], config)
    assert sorted(centres[:, 0].round(3).tolist()) == [0.0, 2.0, 3.0]


def test_signature_is_vlad_by_its_definition() -> None:
    rng = np.random.default_rng(1)
    x, centres = rng.normal(size=(50, 6)).astype(np.float32), rng.normal(size=(4, 6)).astype(np.float32)
    expected = np.zeros((4, 6))
    for row in x:
        word = int(np.argmin([np.linalg.norm(row - c) for c in centres]))
        expected[word] += row - centres[word]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    expected /= np.linalg.norm(expected)
    np.testing.assert_allclose(signature(x, centres), expected.ravel(), atol=1e-5)
    np.testing.assert_array_equal(signature(x[:0], centres), np.zeros(24))
    order = rng.permutation(50)
    np.testing.assert_allclose(signature(x[order], centres), signature(x, centres), atol=1e-5)


def test_bit_strings_become_one_value_a_bit() -> None:
    bits = np.array([[0b10000001, 255], [0, 1]], np.uint8)
    expected = [[1, 0, 0, 0, 0, 0, 0, 1] + [1] * 8, [0] * 15 + [1]]
    np.testing.assert_array_equal(as_float(bits), expected)
    assert as_float(bits).dtype == np.float32


def test_principal_components_keep_what_tells_pictures_apart() -> None:
    rng = np.random.default_rng(2)
    directions = np.linalg.qr(rng.normal(size=(40, 4)))[0].T  # three that differ, one that all share
    sample = rng.normal(size=(60, 3)) * [3, 2, 1] @ directions[:3] + 5 * directions[3]
    basis = principal_components(sample.astype(np.float32), 10)
    assert basis.shape == (3, 40)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(basis @ directions[3], 0, atol=1e-3)
    assert principal_components(sample.astype(np.float32), 2).shape == (2, 40)
    small = compressed(sample[0].astype(np.float32), basis)
    assert np.linalg.norm(small) == pytest.approx(1)
    np.testing.assert_array_equal(compressed(np.zeros(40, np.float32), basis), np.zeros(3))


@pytest.mark.parametrize("separation_s", [0.0, 3.0])
def test_candidates_are_each_ones_nearest_of_those_far_enough_in_time(separation_s: float) -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(30, 8)).astype(np.float32)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    stamps_s = np.sort(rng.uniform(0, 20, 30))
    expected = set()
    for j in range(30):
        others = [i for i in range(30) if i != j and abs(stamps_s[i] - stamps_s[j]) >= separation_s]
        nearest = sorted(others, key=lambda i: np.linalg.norm(x[i] - x[j]))[:4]
        expected |= {(min(i, j), max(i, j)) for i in nearest}
    found = propose(x, 4, lambda j, rows: np.abs(stamps_s[rows] - stamps_s[j]) >= separation_s).pairs
    assert set(found) == expected
    likeness = [float(x[i] @ x[j]) for i, j in found]
    assert likeness == sorted(likeness, reverse=True)


def test_flights_of_one_keyframe_or_of_one_view_are_no_trouble() -> None:
    store = FeatureStore()
    assert look_alikes(store, RetrievalConfig()) == []
    store.append(features_of("sift", STEP)[0])
    assert look_alikes(store, RetrievalConfig()) == []
    for _ in range(3):
        store.append(features_of("sift", STEP)[0])
    pairs = look_alikes(store, RetrievalConfig(neighbours=3))
    assert set(pairs) == {(i, j) for j in range(4) for i in range(j)}


def test_pairs_held_back_by_the_gate_begin_with_the_most_alike() -> None:
    angle = np.array([0.0, 0.1, 0.3, 0.6, 1.0])
    x = np.column_stack([np.cos(angle), np.sin(angle)]).astype(np.float32)
    found = propose(x, 4, lambda j, rows: np.zeros(len(rows), bool))
    assert found.pairs == ()
    assert len(found.gated) == 10
    assert np.all(np.diff([float(x[i] @ x[j]) for i, j in found.gated]) <= 1e-6)
