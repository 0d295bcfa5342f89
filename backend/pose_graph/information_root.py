"""Square roots of joint information, from which covariances follow without a loss of digits along a chain.

A square root W of the information on some variables is upper triangular, and W'W is the information. A clique
of an elimination tree has R x + S s = noise for its own variables x given the others s, and all that the rest
of the graph knows of s is a root U from the parent. So W = [R, S; 0, U]. Covariances handed from parent to
child instead lose a digit every few cliques where the poses of a chain depend on each other.

Source: Bierman 1977, Factorization Methods for Discrete Sequential Estimation (square-root information).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_MANY = 150
"""Rows above which the root of a marginal is Cholesky's factor of the information, in a third of the time of
QR. Digits are lost over many cliques, which are small then."""


def joint_root(R: Array, S: Array, U: Array) -> Array:
    """Return the root (p + r, p + r) of the information on a clique, from (p, p), (p, r) and (r, r)."""
    p, n = len(R), len(R) + len(U)
    W = np.zeros((n, n), order="F")
    W[:p, :p] = R
    W[:p, p:] = S
    W[p:, p:] = U
    return W


def marginal_root(W: Array, kept: Index) -> Array:
    """Return the root (r, r) of the marginal information on the variables in the columns ``kept`` of W."""
    if not len(kept):
        return np.zeros((0, 0))
    others = np.ones(len(W), dtype=bool)
    others[kept] = False
    first = len(W) - len(kept)
    A = np.asfortranarray(W[:, np.concatenate([np.flatnonzero(others), kept])])
    if len(A) > _MANY:
        factor, failed = lapack.dpotrf(blas.dsyrk(1.0, A, trans=1), lower=0, overwrite_a=1)
        if not failed:
            return np.triu(factor[first:, first:])
    return np.triu(lapack.dgeqrf(A, overwrite_a=1)[0][first:, first:])


def covariance_root(W: Array) -> Array:
    """Return V = W^-1, so that V V' is the covariance; NaN if it is singular."""
    V, singular = lapack.dtrtri(W)
    return np.full_like(W, np.nan) if singular else np.asarray(V)
