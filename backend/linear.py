"""A graph's linear system as a sparse matrix, and its factor."""

from __future__ import annotations

from typing import Literal

import gtsam
import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu


def jacobian(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> csc_array:
    """(rows, dimensions) whitened Jacobian at ``values``; gtsam sorts the columns by key."""
    row, column, value = np.asarray(graph.linearize(values).sparseJacobian_())
    size = values.dim()
    left = column <= size  # the last column is the right-hand side
    index = row[left].astype(np.int64) - 1, column[left].astype(np.int64) - 1
    return csc_array((value[left], index), shape=(int(row.max()), size))


def cholesky(
    matrix: csc_array, permutation: Literal["NATURAL", "MMD_AT_PLUS_A"] = "MMD_AT_PLUS_A"
) -> SuperLU:
    """Factor of a symmetric matrix. Raises ``RuntimeError`` where it is singular.

    Pivots stay on the diagonal, so that U's diagonal is that of L D L'.
    """
    return splu(matrix, permc_spec=permutation, diag_pivot_thresh=0, options={"SymmetricMode": True})
