"""Heights of all keyframes above the floor, from their ratios in the pictures and measured ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_array, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU

from backend.pose_graph.linear import cholesky

Array = NDArray[np.float64]

_ROUNDS = 8
"""Iterations; each halves the width of the robust kernel, from 32 to 2 standard deviations."""


@dataclass(frozen=True)
class HeightEstimate:
    """Heights of all keyframes."""

    height_m: Array
    """(n,) heights; in units of the component's mean height if it has no metric measurement."""
    log_std: Array
    """(n,) standard deviation of log(height); without the common scale if that is unknown."""
    metric: NDArray[np.bool_]
    """(n,) True if the keyframe's component has a measured height."""


def adjust_heights(
    count: int,
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    log_ratio: Array,
    log_ratio_std: Array,
    k: NDArray[np.int64],
    log_height: Array,
    log_height_std: Array,
) -> HeightEstimate:
    """Estimate log heights by robust least squares (iteratively reweighted, Cauchy).

    Edges: log h_j - log h_i = ``log_ratio``; measurements: log h_k = ``log_height``. They are linear
    in the logarithm, so that no initial guess is needed. Source: Zhang 1997, section 9 (Cauchy weights);
    Blake and Zisserman 1987, chapter 7 (graduated non-convexity).
    """
    edges, measured = len(i), len(k)
    row = np.concatenate([np.repeat(np.arange(edges), 2), edges + np.arange(measured)])
    column = np.concatenate([np.column_stack([i, j]).ravel(), k])
    value = np.concatenate([np.tile([-1.0, 1.0], edges), np.ones(measured)])
    A = coo_matrix((value, (row, column)), shape=(edges + measured, count)).tocsr()
    b = np.concatenate([log_ratio, log_height])
    sigma = np.maximum(np.concatenate([log_ratio_std, log_height_std]), 1e-6)

    graph = coo_matrix((np.ones(edges), (i, j)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    metric = np.isin(label, label[k])
    # A weak prior fixes a component without a measured height at a mean logarithm of about 0.
    weak = csc_matrix((np.full(count, 1e-6), (np.arange(count), np.arange(count))), shape=(count, count))

    weight = np.ones(len(b))
    x = np.zeros(count)
    factor = None
    for number in range(_ROUNDS):
        W = weight / sigma**2
        factor = cholesky(csc_array(A.T @ A.multiply(W[:, None]) + weak))
        x = factor.solve(A.T @ (W * b))
        # The kernel starts wide and narrows: outliers first bias their neighbours, which must not be rejected
        # for that.
        width = max(2.0, 32.0 * 0.5**number)
        weight = 1.0 / (1.0 + ((A @ x - b) / (width * sigma)) ** 2)
    assert factor is not None
    return HeightEstimate(np.exp(x), np.sqrt(np.where(metric, _variances(factor), 0.0)), metric)


def _variances(factor: SuperLU) -> Array:
    """Return the diagonal (n,) of the inverse of a factorised matrix L D L' without dense columns.

    Row j of the inverse on the pattern of column j of L depends on the rows below in that pattern alone. All
    of these are in the pattern of the first of them: no entry of the factor cancels, since all entries beside
    the diagonal are negative. Source: Takahashi, Fagan and Chen 1973.
    """
    L, D = csc_array(factor.L), factor.U.diagonal()
    L.sort_indices()
    rows, columns = (np.split(each, L.indptr[1:-1]) for each in (L.indices, L.data))
    inverse: dict[int, Array] = {}
    waiting = np.bincount([each[1] for each in rows if len(each) > 1], minlength=len(D))
    variance = np.empty(len(D))
    for j in reversed(range(len(D))):
        below, column = rows[j][1:], columns[j][1:]
        own = np.empty((len(below) + 1,) * 2)
        if len(below):
            parent = int(below[0])
            at = np.searchsorted(rows[parent], below)
            own[1:, 1:] = inverse[parent][at[:, None], at]
            waiting[parent] -= 1
            if not waiting[parent]:
                del inverse[parent]
        own[1:, 0] = own[0, 1:] = -own[1:, 1:] @ column
        own[0, 0] = variance[j] = 1 / D[j] - own[0, 1:] @ column
        if waiting[j]:
            inverse[j] = own
    return np.asarray(variance[factor.perm_c])
