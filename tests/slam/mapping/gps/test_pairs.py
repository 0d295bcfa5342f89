"""Pairs drawn without a list of all of them are those of the list."""

import tracemalloc

import numpy as np
import pytest

from slam.mapping.gps.pairs import some_pairs


@pytest.mark.parametrize("n", [0, 1, 2, 5, 46])
def test_few_pairs_are_all_pairs(n: int) -> None:
    i, j = some_pairs(n, 2000, np.random.default_rng(0))
    assert np.array_equal([i, j], np.triu_indices(n, 1))


def test_drawn_pairs_are_different_pairs_of_the_list() -> None:
    i, j = some_pairs(100, 1000, np.random.default_rng(0))
    assert np.all((i >= 0) & (i < j) & (j < 100))
    assert len(set(zip(i.tolist(), j.tolist(), strict=True))) == 1000
    assert abs(i.mean() - 33) < 3, "uniform over the triangle"


def test_memory_does_not_grow_with_all_pairs() -> None:
    tracemalloc.start()
    some_pairs(100_000, 1000, np.random.default_rng(0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10e6
