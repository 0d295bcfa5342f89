"""Parts of the flights that speak of one size agree; parts that do not are found out."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism.verdict.consistency import _consistency

ROWS, PARTS = 6000, 6


def drawn(seed, sizes):
    """Information and score, at the common sizes, of two nuisances and a cause with its size in each part."""
    rng = np.random.default_rng(seed)
    traces = rng.standard_normal((ROWS, 3)) * 0.3
    part = rng.integers(0, PARTS, ROWS)
    white = rng.standard_normal(ROWS) + traces @ [0.5, -0.2, 0.0] + traces[:, 2] * np.asarray(sizes)[part]
    white -= traces @ np.linalg.solve(traces.T @ traces, white @ traces)
    own = [part == k for k in range(PARTS)]
    information = np.array([traces[k].T @ traces[k] for k in own])
    return information, np.array([white[k] @ traces[k] for k in own]), np.arange(PARTS)


def deviates(sizes, count=200):
    own, precision = np.array([2]), np.zeros(3)
    return np.array([_consistency("flight", *drawn(s, sizes), own, precision).z for s in range(count)])


def test_one_size_in_all_parts_agrees():
    z = deviates([1.0] * PARTS)
    # Half of the chi-squares lie below their mean or near it; one in twenty beyond the two-sided 1.96.
    assert np.mean(z > 1.96) < 0.1
    assert np.mean(z > 1.96) > 0.005
    assert z.max() < 4.0


@pytest.mark.parametrize("sizes", [[1, 1, 1, 1, 1, 0], [1, -1, 1, -1, 1, -1]])
def test_sizes_that_differ_do_not(sizes):
    assert np.median(deviates(sizes, 20)) > 4.0
