"""Sparse Jacobian of a graph, elimination order, and Cholesky factor."""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

Index = NDArray[np.int64]


def jacobian(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, order: Index | None = None
) -> csc_array:
    """Return the whitened Jacobian (rows, dimensions) at ``values``.

    Columns are sorted by key, or permuted to ``order`` (dimensions,).
    """
    return linear_system(graph, values, order)[0]


def linear_system(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, order: Index | None = None
) -> tuple[csc_array, NDArray[np.float64]]:
    """Return the Jacobian, as `jacobian` does, and the right-hand side (rows,): minus the whitened errors.

    Variables that no factor touches have columns of zeros.
    """
    row, column, value = np.asarray(graph.linearize(values).sparseJacobian_())
    size, count = values.dim(), int(row.max())
    # gtsam leaves the columns of other variables out.
    touched = np.arange(size) if graph.keys().size() == values.size() else _touched(graph, values)
    left = column <= len(touched)  # the last column is the right-hand side
    right = np.zeros(count)
    right[row[~left].astype(np.int64) - 1] = value[~left]
    at = touched[column[left].astype(np.int64) - 1]
    if order is not None:
        place = np.empty(size, dtype=np.int64)
        place[order] = np.arange(size)
        at = place[at]
    matrix = csc_array((value[left], (row[left].astype(np.int64) - 1, at)), shape=(count, size))
    return matrix, right


def _touched(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Index:
    """Return the columns, among those of all variables, of the variables that a factor touches."""
    keys = graph.keys()
    dims = sorted(values.dims().items())
    return np.flatnonzero(np.repeat([keys.count(key) > 0 for key, _ in dims], [width for _, width in dims]))


def elimination_order(graph: gtsam.NonlinearFactorGraph, d: int) -> Index:
    """Return (n d,) columns of variables 0..n-1 of ``d`` dimensions in a fill-reducing order.

    The columns of a variable stay together: on a pose graph this halves the time of a factorisation.
    """
    found = gtsam.Ordering.ColamdNonlinearFactorGraph(graph)
    keys = np.array([found.at(k) for k in range(found.size())], dtype=np.int64)
    return (d * keys[:, None] + np.arange(d)).ravel()


def cholesky(
    matrix: csc_array, permutation: Literal["NATURAL", "MMD_AT_PLUS_A"] = "MMD_AT_PLUS_A"
) -> SuperLU:
    """Factorise a symmetric matrix. Raises ``RuntimeError`` if it is singular.

    Pivots stay on the diagonal, so that U's diagonal is that of L D L'. `backend.sparse_cholesky` analyses a
    pattern once for many factorisations, names the variable that is not determined, and gives blocks of the
    inverse; SuperLU takes a third of its time for one factor of a pose graph.
    """
    return splu(matrix, permc_spec=permutation, diag_pivot_thresh=0, options={"SymmetricMode": True})
