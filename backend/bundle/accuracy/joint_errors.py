"""The largest independent errors of all poses of a refined map together.

The covariance of one pose does not tell how its error goes with those of the others. On a figure eight of 160
keyframes a few numbers, as the scale, a bend or a tilt of the whole path, are most of every error. They are
the leading eigenvectors of the joint correlation of all poses: with ``S`` the joint covariance of the
perturbations and ``S_k = L_k L_k'`` that of pose k, those of ``L^-1 S L^-T``. Lanczos' method finds them with
a solve of the normal equations a step, so that the joint covariance is never built.

Source: Förstner and Wrobel 2016, section 4.2.3; Golub and Van Loan 2013, section 10.1.
"""

from __future__ import annotations

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from backend.bundle.factors import WORLD
from backend.bundle.metric_poses import metric_jacobians
from backend.bundle.minimise import BundleOptimum

Array = NDArray[np.float64]

_TOLERANCE = 1e-3
"""Relative error of their variances, far below what tells in the band of a mean of squared errors."""
_SINGULAR = 1e-12
"""Eigenvalue of a correlation matrix below which its direction is fixed: that of the first pose by choice."""


def joint_errors(optimum: BundleOptimum, covariances: Array, count: int) -> Array:
    """Return (n, 6, count) the displacement of all poses by each of their largest independent errors.

    A column is the right perturbation, rotation first, by one standard deviation of one error, the largest
    error first. ``covariances`` (n, 6, 6) are those of the poses. Columns of a
    pose without known covariance are zero, and so are those of more errors than the poses have.

    Raises ``SingularMatrixError`` if a direction is open, and ``ArpackError`` if no pose has a covariance.
    """
    problem, values = optimum.problem, optimum.values
    reduced = optimum.linearise().eliminate()
    columns = reduced.structure.columns
    J = metric_jacobians(problem, values)
    of_poses = reduced.structure.columns_of([POSE(k) for k in range(len(J))])
    factor, inverse = _square_roots(covariances)

    def times(whitened: Array) -> Array:
        by_pose = np.einsum("kaq,ka->kq", J, np.einsum("kba,kb->ka", inverse, whitened.reshape(-1, 6)))
        right = np.zeros(reduced.size)
        right[of_poses] = by_pose[:, :6]
        right[columns(WORLD)] = by_pose[:, 6:].sum(axis=0)
        x = reduced.factor.solve(right)
        moved = np.einsum("kaq,kq->ka", J[:, :, :6], x[of_poses]) + J[:, :, 6:] @ x[columns(WORLD)]
        return np.asarray(np.einsum("kab,kb->ka", inverse, moved).ravel())

    size = 6 * len(J)
    kept = min(count, size - 1)
    operator = LinearOperator((size, size), matvec=times, dtype=float)
    variance, mode = eigsh(operator, kept, v0=np.ones(size), tol=_TOLERANCE)
    found = np.zeros((len(J), 6, count))
    by_one_std = np.asarray(mode * np.sqrt(np.maximum(variance, 0.0)))[:, ::-1]
    found[:, :, :kept] = factor @ by_one_std.reshape(len(J), 6, kept)
    return found


def _square_roots(covariances: Array) -> tuple[Array, Array]:
    """Return roots F (n, 6, 6), F F' the covariances, and their inverses; both without fixed directions."""
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    P = np.where(known[:, None, None], covariances, 0.0)
    std = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    # Radians and metres differ by orders of magnitude: a correlation has no unit.
    by_std = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    eigenvalue, V = np.linalg.eigh(by_std[:, :, None] * P * by_std[:, None, :])
    root: Array = np.sqrt(np.where(eigenvalue > _SINGULAR, eigenvalue, 0.0))
    by_root = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0)
    factor = std[:, :, None] * V * root[:, None, :]
    inverse = (V * by_root[:, None, :]).transpose(0, 2, 1) * by_std[:, None, :]
    return factor, inverse
