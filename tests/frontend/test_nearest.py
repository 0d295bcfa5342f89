"""The inverted file against brute force, and candidates behind a gate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from frontend import nearest
from frontend.nearest import InvertedFile
from frontend.retrieval import propose


def unit(rng: np.random.Generator, n: int, d: int = 32) -> np.ndarray:
    x = rng.normal(size=(n, d)).astype(np.float32)
    return x / np.linalg.norm(x, axis=1, keepdims=True)


@pytest.fixture
def many_cells(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(nearest, "EXACT_UP_TO", 500)
    return


def test_few_vectors_are_all_looked_at():
    x = unit(np.random.default_rng(0), 300)
    rows, likeness = InvertedFile(x).likely(x[7])
    assert sorted(rows.tolist()) == list(range(300))
    np.testing.assert_allclose(likeness, x[rows] @ x[7], atol=1e-6)


def test_of_many_a_part_is_looked_at_and_places_are_found_again(many_cells: None):
    rng = np.random.default_rng(1)
    x = unit(rng, 5000)
    again = x[:200] + 0.6 * unit(rng, 200)
    again /= np.linalg.norm(again, axis=1, keepdims=True)
    index, same = InvertedFile(x), InvertedFile(x)
    hits, looked_at = 0, 0
    for k, vector in enumerate(again):
        rows, likeness = index.likely(vector)
        np.testing.assert_allclose(likeness, x[rows] @ vector, atol=1e-5)
        np.testing.assert_array_equal(rows, same.likely(vector)[0])
        assert len(set(rows.tolist())) == len(rows)
        hits += rows[np.argmax(likeness)] == k
        looked_at += len(rows)
    assert looked_at < 0.25 * 200 * 5000
    assert hits > 0.85 * 200
    everything = np.concatenate([index._order])
    assert sorted(everything.tolist()) == list(range(5000))


@pytest.mark.parametrize("n", [1, 2, 60])
def test_candidates_are_the_nearest_that_the_gate_lets_pass(n):
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
    likeness = [float(x[i] @ x[j]) for i, j in found.pairs]
    assert likeness == sorted(likeness, reverse=True)
