"""The inverted file against brute force, and gated candidates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from frontend import inverted_file
from frontend.inverted_file import InvertedFile
from frontend.retrieval import propose


def unit(rng: np.random.Generator, n: int, d: int = 32) -> np.ndarray:
    x = rng.normal(size=(n, d)).astype(np.float32)
    return x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.fixture
def many_cells(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(inverted_file, "MAX_EXHAUSTIVE", 500)
    return


def test_few_vectors_are_searched_exhaustively():
    x = unit(np.random.default_rng(0), 300)
    rows, similarity = InvertedFile(x).candidates(x[7])
    assert sorted(rows.tolist()) == list(range(300))
    np.testing.assert_allclose(similarity, x[rows] @ x[7], atol=1e-6)


def test_many_vectors_are_searched_in_part_with_high_recall(many_cells: None):
    rng = np.random.default_rng(1)
    x = unit(rng, 5000)
    revisits = x[:200] + 0.6 * unit(rng, 200)
    revisits /= np.linalg.norm(revisits, axis=1, keepdims=True)
    index, same = InvertedFile(x), InvertedFile(x)
    hits, searched = 0, 0
    for k, vector in enumerate(revisits):
        rows, similarity = index.candidates(vector)
        np.testing.assert_allclose(similarity, x[rows] @ vector, atol=1e-5)
        np.testing.assert_array_equal(rows, same.candidates(vector)[0])
        assert len(set(rows.tolist())) == len(rows)
        hits += rows[np.argmax(similarity)] == k
        searched += len(rows)
    assert searched < 0.25 * 200 * 5000
    assert hits > 0.85 * 200
    everything = np.concatenate([index._order])
    assert sorted(everything.tolist()) == list(range(5000))


@pytest.mark.parametrize("n", [1, 2, 60])
def test_candidates_are_the_nearest_within_the_gate(n):
    rng = np.random.default_rng(2)
    x = unit(rng, n, 6)
    allowed = rng.random((n, n)) < 0.4
    allowed |= allowed.T
    found = propose(x, 3, lambda j, rows: allowed[j, rows])
    expected, nearest_of_all = set(), set()
    for j in range(n):
        others = sorted((i for i in range(n) if i != j), key=lambda i: -float(x[i] @ x[j]))
        expected |= {(min(i, j), max(i, j)) for i in [i for i in others if allowed[j, i]][:3]}
        nearest_of_all |= {(min(i, j), max(i, j)) for i in others[:3] if not allowed[j, i]}
    assert set(found.pairs) == expected
    assert set(found.gated) == nearest_of_all
    similarity = [float(x[i] @ x[j]) for i, j in found.pairs]
    assert similarity == sorted(similarity, reverse=True)
