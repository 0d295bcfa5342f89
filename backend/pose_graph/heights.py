"""Heights of all keyframes above the floor, from their ratios in the pictures and measured ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

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
        factor = splu(csc_matrix(A.T @ A.multiply(W[:, None]) + weak))
        x = factor.solve(A.T @ (W * b))
        # The kernel starts wide and narrows: outliers first bias their neighbours, which must not be rejected
        # for that.
        width = max(2.0, 32.0 * 0.5**number)
        weight = 1.0 / (1.0 + ((A @ x - b) / (width * sigma)) ** 2)
    assert factor is not None
    variance = np.array([factor.solve(np.eye(1, count, q).ravel())[q] for q in range(count)])
    return HeightEstimate(np.exp(x), np.sqrt(np.where(metric, variance, 0.0)), metric)
