"""The sparse Cholesky factorisation against dense linear algebra, over random patterns."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array

from backend.sparse_cholesky import SingularMatrixError, analyse, factorise


def matrix(rng: np.random.Generator, pairs: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """A positive definite matrix with entries of each variable, and of the pairs of variables."""
    begin = np.concatenate([[0], np.cumsum(widths)])
    blocks = [np.arange(a, b) for a, b in itertools.pairwise(begin)]
    dense = 0.1 * np.eye(begin[-1])
    for i, j in pairs:
        rows = np.concatenate([blocks[i], blocks[j]])
        J = rng.normal(size=(3, len(rows)))
        dense[np.ix_(rows, rows)] += J.T @ J
    return dense


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 40),
    density=st.floats(0.0, 3.0),
    hub=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_solution_and_covariances_are_those_of_the_dense_matrix(
    n: int, density: float, hub: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    widths = rng.integers(1, 7, n)
    pairs = rng.integers(0, n, (int(density * n), 2))
    if hub:  # one variable tied to all
        pairs = np.vstack([pairs, np.column_stack([np.full(n, n // 2), np.arange(n)])])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    dense = matrix(rng, pairs, widths)
    elimination = analyse(pairs, widths)
    columns = elimination.columns(np.arange(n))
    permuted = np.empty_like(dense)
    permuted[np.ix_(columns, columns)] = dense
    # The matrix is given as a sum.
    share = rng.integers(0, 2, dense.shape)
    factor = factorise(elimination, [csc_array(permuted * share), csc_array(permuted * (1 - share))])
    right = rng.normal(size=(len(dense), 2))
    x = factor.solve(right[np.argsort(columns)])[columns]
    np.testing.assert_allclose(dense @ x, right, atol=1e-9 * np.linalg.cond(dense))
    inverse, begin = np.linalg.inv(dense), np.concatenate([[0], np.cumsum(widths)])
    found = factor.covariances(np.arange(n)[::-1])[::-1]
    for v, block in enumerate(found):
        own = slice(begin[v], begin[v + 1])
        np.testing.assert_allclose(block, inverse[own, own], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("tied", [False, True])
def test_a_variable_that_is_not_determined_is_named(tied: bool) -> None:
    """A chain of points without a place, or one variable without an entry."""
    rng, n = np.random.default_rng(0), 12
    pairs = np.array([(k, k + 1) for k in range(n - 1) if tied or 7 not in (k, k + 1)])
    dense = np.zeros((n, n))
    for i, j in pairs:
        J = np.zeros(n)
        J[[i, j]] = 1.0, -1.0
        dense += np.outer(J, J) * rng.uniform(1, 1e6)
    if not tied:
        dense[[0, 8], [0, 8]] += 1.0
    elimination = analyse(pairs, np.ones(n, dtype=np.int64))
    columns = elimination.columns(np.arange(n))
    permuted = np.empty_like(dense)
    permuted[np.ix_(columns, columns)] = dense
    with pytest.raises(SingularMatrixError) as caught:
        factorise(elimination, [csc_array(permuted)])
    assert tied or caught.value.variable == 7
