"""Isotropic approximation of a pose graph: synchronisation over SE(d) with chordal distances.

    F(R, t) = sum kappa |R_j - R_i R_ij|^2 + tau |t_j - t_i - R_i t_ij|^2

It is quadratic except for the constraint that R_i are rotations, so that its global optimum can be certified.
Source: Rosen, Carlone, Bandeira, Leonard 2019 (IJRR), "SE-Sync", equation 12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csc_array, csr_array
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial.transform import Rotation

from backend import se3
from backend.errors import BackendError
from backend.pose_graph.linear import cholesky

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_FILL = 6_000_000
"""Maximum number of entries of a triangular factor: about a second, in which Ctrl-C waits."""

_MAX_STEPS = 30
_MIN_RELATIVE_GAIN = 1e-17
"""Predicted relative decrease at which the descent ends; the lower bound needs this accuracy."""
_ROUNDING = 1e-12
_FORCING = 1e-2
_MAX_CG_ITERATIONS = 15
"""Number of iterations above which a new factor is computed."""
_EDGES_AT_ONCE = 2048
"""Number of edges whose Jacobians are in memory, 2.5 kB each in space."""


@dataclass(frozen=True)
class Synchronization:
    """Connected isotropic problem with rotations ``ij_R`` (m, d, d) and translations ``ij_t_m`` (m, d)."""

    count: int
    i: Index
    j: Index
    ij_R: Array
    ij_t_m: Array
    kappa: Array
    """(m,) weight of the squared chordal distance of rotations: half the information per rad^2."""
    tau: Array
    """(m,) weight of the squared distance: information per m^2."""

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return int(self.ij_R.shape[-1])

    def edges(self, some: slice) -> Synchronization:
        """Return the problem of some of the edges."""
        return Synchronization(
            self.count,
            self.i[some],
            self.j[some],
            self.ij_R[some],
            self.ij_t_m[some],
            self.kappa[some],
            self.tau[some],
        )

    def residuals(self, w_R: Array, w_t: Array) -> tuple[Array, Array, Array]:
        """Return residual translations (m, d) and rotations (m, d, d) in axes of i, and R_i' R_j."""
        turn = np.swapaxes(w_R[self.i], 1, 2)
        relative = turn @ w_R[self.j]
        step = np.einsum("mab,mb->ma", turn, w_t[self.j] - w_t[self.i])
        return step - self.ij_t_m, relative - self.ij_R, relative

    def objective(self, w_R: Array, w_t: Array) -> float:
        """Return F."""
        translation, rotation, _ = self.residuals(w_R, w_t)
        squares = self.tau * (translation**2).sum(axis=1) + self.kappa * (rotation**2).sum(axis=(1, 2))
        return float(squares.sum())

    def multipliers(self, w_R: Array, w_t: Array) -> Array:
        """Return the multipliers (n, d, d) of R' R = I, in axes of each pose. Source: equation 107 there."""
        translation, rotation, relative = self.residuals(w_R, w_t)
        coupling = self.tau[:, None, None] * translation[:, :, None] * self.ij_t_m[:, None, :]
        at_i = -self.kappa[:, None, None] * (rotation @ np.swapaxes(self.ij_R, 1, 2)) - coupling
        at_j = self.kappa[:, None, None] * (np.swapaxes(relative, 1, 2) @ rotation)
        out = np.zeros((self.count, self.dimension, self.dimension))
        np.add.at(out, self.i, at_i)
        np.add.at(out, self.j, at_j)
        return np.asarray((out + np.swapaxes(out, 1, 2)) / 2)


def isotropic(information: Array) -> tuple[Array, Array]:
    """Return kappa and tau (m,) for the mean variances of information matrices (m, 3, 3) or (m, 6, 6).

    They are 0 for a singular matrix. Source: SE-Sync's own reader of g2o files, which in the plane takes
    twice this kappa.
    """
    if information.shape[-1] == 3:
        return information[:, 2, 2] / 2, _harmonic_mean(information[:, :2, :2])
    return _harmonic_mean(information[:, :3, :3]) / 2, _harmonic_mean(information[:, 3:, 3:])


def _harmonic_mean(information: Array) -> Array:
    values = np.linalg.eigvalsh(information)
    closed = values[:, 0] > 1e-12 * values[:, -1]
    return np.where(closed, values.shape[1] / (1 / np.where(closed[:, None], values, 1)).sum(axis=1), 0)


def descend(problem: Synchronization, w_R: Array, w_t: Array, order: Index) -> tuple[Array, Array]:
    """Descend to a minimum of F: rotations (n, d, d) and positions (n, d); pose 0 is fixed.

    Newton steps by conjugate gradients are preconditioned by a factor in the ``elimination_order``, which is
    reused for several steps. It is that of the Gauss-Newton model, without the curvature of the rotations,
    which is always convex. Raises ``BackendError`` if a linear system is singular.
    """
    value = problem.objective(w_R, w_t)
    factor: Factor | None = None
    for _ in range(_MAX_STEPS):
        gradient, diagonal, curve, coupling = _model(problem, w_R, w_t)
        factor = factor or Factor(assembled(problem, diagonal, coupling, begin=1), order)
        hessian = assembled(problem, diagonal + curve, coupling, begin=1)
        step, iterations = _newton_step(hessian, gradient, factor)
        predicted_decrease = -float(gradient @ step)
        if predicted_decrease <= _MIN_RELATIVE_GAIN * max(value, 1e-6 * len(problem.i)):
            return w_R, w_t
        length = 1.0
        for _ in range(20):
            moved = _retract(w_R, w_t, length * step)
            lower = problem.objective(*moved)
            if lower <= value * (1 + _ROUNDING):
                break
            length /= 2
        else:
            return w_R, w_t
        (w_R, w_t), value = moved, lower
        factor = factor if iterations <= _MAX_CG_ITERATIONS else None
    return w_R, w_t


def _newton_step(hessian: csc_array, gradient: Array, factor: Factor) -> tuple[Array, int]:
    """Return a step and its number of iterations."""
    operator = LinearOperator(hessian.shape, matvec=factor.solve, dtype=np.float64)
    done: list[None] = []
    step, _ = cg(
        hessian, -gradient, rtol=_FORCING, maxiter=60, M=operator, callback=lambda _: done.append(None)
    )
    if float(gradient @ step) < 0 <= float(step @ (hessian @ step)):
        return np.asarray(step), len(done)
    return -factor.solve(gradient), len(done)


def _retract(w_R: Array, w_t: Array, step: Array) -> tuple[Array, Array]:
    n, d = w_t.shape
    xi = np.concatenate([np.zeros(_width(d)), step]).reshape(n, -1)
    turn = (
        se3.from_planar(np.column_stack([np.zeros((n, 2)), xi[:, 0]]))[:, :2, :2]
        if d == 2
        else Rotation.from_rotvec(xi[:, :3]).as_matrix()
    )
    return w_R @ turn, w_t + np.einsum("nab,nb->na", w_R, xi[:, -d:])


def _width(d: int) -> int:
    return d * (d + 1) // 2


def _model(problem: Synchronization, w_R: Array, w_t: Array) -> tuple[Array, Array, Array, Array]:
    """Return half of gradient and Hessian by right perturbations (rotation, translation), p = 3 or 6 numbers.

    They are the gradient (n p - p,) without the first pose, the Gauss-Newton matrix on the diagonal
    (n, p, p), what the curvature of the rotations adds there (n, p, p), and the blocks of the edges
    (m, p, p), as in ``assembled``.
    """
    n, m, p = problem.count, len(problem.i), _width(problem.dimension)
    gradient, diagonal, coupling = np.zeros((n, p)), np.zeros((n, p, p)), np.empty((m, p, p))
    for begin in range(0, m, _EDGES_AT_ONCE):
        some = slice(begin, begin + _EDGES_AT_ONCE)
        edges = problem.edges(some)
        g, H = _edge_models(edges, w_R, w_t)
        np.add.at(gradient, edges.i, g[:, :p])
        np.add.at(gradient, edges.j, g[:, p:])
        np.add.at(diagonal, edges.i, H[:, :p, :p])
        np.add.at(diagonal, edges.j, H[:, p:, p:])
        coupling[some] = H[:, :p, p:]
    multipliers, skew = problem.multipliers(w_R, w_t), _skew_basis(problem.dimension)
    curve = np.zeros((n, p, p))
    for a, E in enumerate(skew):
        for b, D in enumerate(skew):
            curve[:, a, b] = -np.einsum("xa,nxy,ya->n", E, multipliers, D)
    return gradient.ravel()[p:], diagonal, curve, coupling


def _edge_models(edges: Synchronization, w_R: Array, w_t: Array) -> tuple[Array, Array]:
    """Return half of gradient (m, 2p) and Gauss-Newton matrix (m, 2p, 2p) of each edge by its two poses."""
    d, p, m = edges.dimension, _width(edges.dimension), len(edges.i)
    skew = _skew_basis(d)
    translation, rotation, relative = edges.residuals(w_R, w_t)
    J = np.zeros((m, d + d * d, 2 * p))
    for a, E in enumerate(skew):
        J[:, :d, a] = -edges.ij_t_m @ E.T
        J[:, d:, a] = -(E @ edges.ij_R).reshape(m, -1)
        J[:, d:, p + a] = (relative @ E).reshape(m, -1)
    J[:, :d, len(skew) : p] = -np.eye(d)
    J[:, :d, p + len(skew) :] = relative
    weight = np.repeat(np.column_stack([edges.tau, edges.kappa]), [d, d * d], axis=1)
    weighted = weight[:, :, None] * J
    residual = np.hstack([translation, rotation.reshape(m, -1)])
    return np.einsum("mra,mr->ma", weighted, residual), np.swapaxes(J, 1, 2) @ weighted


def _skew_basis(d: int) -> Array:
    return np.array([[[0.0, -1], [1, 0]]]) if d == 2 else se3.cross_matrix(np.eye(3))


def assembled(problem: Synchronization, diagonal: Array, coupling: Array, begin: int = 0) -> csc_array:
    """Assemble a symmetric matrix (n q, n q) from its diagonal blocks (n, q, q) and those (m, q, q) at row i
    and column j of each edge. The poses before ``begin`` are left out."""
    n, m, q = problem.count, len(problem.i), diagonal.shape[-1]
    row = np.concatenate([np.arange(n), problem.i, problem.j])
    column = np.concatenate([np.arange(n), problem.j, problem.i])
    kept = (row >= begin) & (column >= begin)
    order = np.lexsort([column, row])
    order = order[kept[order]]
    place = np.empty_like(row)
    place[order] = np.arange(len(order))
    blocks = np.empty((len(order), q, q))
    blocks[place[begin:n]] = diagonal[begin:]
    joined = np.flatnonzero(kept[n : n + m])
    blocks[place[n + joined]] = coupling[joined]
    blocks[place[n + m + joined]] = np.swapaxes(coupling[joined], 1, 2)
    starts = np.concatenate([[0], np.cumsum(np.bincount(row[kept] - begin, minlength=n - begin))])
    size = (n - begin) * q
    by_row = bsr_array((blocks, column[order] - begin, starts), shape=(size, size)).tocsr()
    # It equals its transpose, whose columns these rows are.
    matrix = csc_array((by_row.data, by_row.indices, by_row.indptr), shape=by_row.shape)
    matrix.sum_duplicates()  # of repeated edges
    return matrix


def elimination_order(problem: Synchronization) -> Index:
    """Return poses in a fill-reducing order. Raises ``BackendError`` if the fill-in is too large."""
    n = problem.count
    ones = np.ones((len(problem.i), 1, 1))
    degree = np.bincount(np.concatenate([problem.i, problem.j]), minlength=n)
    factor = cholesky(assembled(problem, 1.0 + degree[:, None, None].astype(np.float64), -ones))
    if factor.L.nnz * _width(problem.dimension) ** 2 > MAX_FILL:
        raise BackendError("its loops are too many to factorise")
    return np.argsort(factor.perm_c)


class Factor:
    """Factor L D L' of a symmetric matrix of equal blocks; the first pose's may lack some rows.

    ``order`` is the elimination order of the poses. Raises ``BackendError`` for a singular matrix.
    """

    def __init__(self, matrix: csc_array, order: Index) -> None:
        n = len(order)
        q = -(-matrix.shape[0] // n)
        missing = n * q - matrix.shape[0]
        rows = (order[:, None] * q + np.arange(q)).ravel() - missing
        self._rows = rows[rows >= 0]
        try:
            self._factor = cholesky(_permuted(matrix, self._rows), "NATURAL")
        except RuntimeError as error:
            raise BackendError(f"its linear system is singular: {error}") from error

    @property
    def negative(self) -> int:
        """Number of negative pivots, which equals that of negative eigenvalues (Sylvester)."""
        return int((self._factor.U.diagonal() <= 0).sum())

    def solve(self, rhs: Array) -> Array:
        """Solve the linear system."""
        out = np.empty_like(rhs)
        out[self._rows] = self._factor.solve(rhs[self._rows])
        return out


def _permuted(matrix: csc_array, rows: Index) -> csc_array:
    """Return a symmetric matrix with its rows and columns in another order, in a single copy."""
    place = np.empty(len(rows), dtype=matrix.indices.dtype)
    place[rows] = np.arange(len(rows))
    # Its columns are its rows, and the numbers of the columns are replaced, so that no column is moved.
    by_row = csr_array((matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)[rows]
    return csc_array((by_row.data, place[by_row.indices], by_row.indptr), shape=matrix.shape)
