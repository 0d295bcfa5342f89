"""Consistency of covariances: the normalised estimation error squared (NEES).

Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.
For ``xi = Log(w_T_b_hat^-1 w_T_b_true)`` of covariance P, ``xi' P^-1 xi`` is chi-square with 6 degrees of
freedom. Its mean over keyframes is 6 where the covariances are right, and larger where they are too small.

Band of that mean: errors of neighbouring keyframes are nearly equal, so n keyframes count as far fewer
independent ones. The textbook band (chi-square with 6 n degrees) would reject a consistent estimate nearly
always. Here each of the six whitened errors z is modelled as a first-order Markov sequence, the typical error
of integrated odometry plus measurement noise. Under the tested hypothesis z has unit variance, so the mean
squared step between neighbours gives its correlation: ``rho = 1 - E[(z_k+1 - z_k)^2] / 2``. For Gaussian z
the squares correlate as rho^(2 lag). Without shared errors the variance of the mean is then ``12 / n_eff``
with ``n_eff = n / mean over the six of [1 + 2 sum_lag (1 - lag/n) rho^(2 lag)]``, and the band is that of a
chi-square with ``6 n_eff`` degrees divided by n_eff (Satterthwaite's match of mean and variance). Over
simulated Markov, random-walk and pinned-walk errors it holds 89.7 to 97 % of the time. For much smoother
errors it is wider than necessary.

Errors that all poses share are no such sequence. A wrong scale moves each pose along the vector from the
first one to it. Where the path turns, neighbours differ in that error, and distant poses still share it. On a
map of loops a dozen such errors are most of what there is. Where they are given (u_km of error m, whitened as
z is), ``z_k = sum_m s_m u_km + r_k`` with independent numbers s of unit variance, and r is the sequence, of
the variance that is left. The mean of squares is then a sum of chi-squares whose weights are the eigenvalues
of ``sum_k u_k' u_k / n``, and of that of r, all axes together. Its quantiles are the band. With joint errors
of the paper's figure eight, `tests/benchmarks/bound.py` counts the flights inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from slam.evaluation.weighted_chi_squares import weighted_chi_square_interval

Array = NDArray[np.float64]

_SINGULAR = 1e-12
"""Smallest eigenvalue of the correlation matrix below which a covariance cannot be inverted."""


@dataclass(frozen=True)
class Consistency:
    """Mean NEES over keyframes and the band that it should lie in."""

    dof: int
    """Expected value of the mean."""
    mean: float
    lower95: float
    upper95: float
    n_eff: float
    """Number of independent keyframes that carry the same evidence; below 1 where one error is most of all,
    as a single number is less than a pose."""

    @property
    def consistent(self) -> bool:
        """Whether the mean lies in its 95 % band."""
        return self.lower95 <= self.mean <= self.upper95


@dataclass(frozen=True)
class Nees:
    """Consistency of poses, and of their position and rotation blocks alone."""

    pose: Consistency
    position: Consistency
    rotation: Consistency
    per_keyframe: Array
    """(n,) NEES of each pose, 6 expected; NaN where the pose has no usable covariance."""
    left_out: int
    """Number of keyframes without a positive definite covariance, or with NaN."""


def nees(w_T_b_hat: Array, w_T_b_true: Array, covariances: Array, shared: Array | None = None) -> Nees | None:
    """Compute the NEES of (n, 4, 4) poses in order of time with their (n, 6, 6) covariances.

    All poses must have one gauge. The pose that fixes it must not be among them: its error is zero by
    construction. ``shared`` (n, 6, s) are right perturbations of the poses by one standard deviation of each
    of s independent errors that they share. The result is None where no covariance is usable.
    """
    xi_w, P_w, B = world_errors(w_T_b_hat, w_T_b_true, covariances)
    usable = np.array([_invertible(P) for P in P_w], dtype=bool)
    if not usable.any():
        return None
    xi_w, P_w = xi_w[usable], P_w[usable]
    shared_w = np.zeros((len(xi_w), 6, 0)) if shared is None else B[usable] @ shared[usable]
    whitened = _whiten(xi_w[:, :, None], P_w)[:, :, 0]
    per_keyframe = np.full(len(usable), np.nan)
    per_keyframe[usable] = np.sum(whitened**2, axis=1)
    return Nees(
        pose=_of_block(slice(0, 6), xi_w, P_w, shared_w),
        position=_of_block(slice(3, 6), xi_w, P_w, shared_w),
        rotation=_of_block(slice(0, 3), xi_w, P_w, shared_w),
        per_keyframe=per_keyframe,
        left_out=int((~usable).sum()),
    )


def world_errors(w_T_b_hat: Array, w_T_b_true: Array, covariances: Array) -> tuple[Array, Array, Array]:
    """Return right perturbations (n, 6) and their covariances (n, 6, 6), both in world axes, and the matrices
    (n, 6, 6) that rotate from body axes to world axes.

    The NEES is the same in any axes. In world axes a turn of the vehicle does not hide that the errors before
    and after it are one error.
    """
    xi = RigidTransform.from_matrix(np.linalg.inv(w_T_b_hat) @ w_T_b_true).as_exp_coords()
    B = np.zeros((len(xi), 6, 6))
    B[:, :3, :3] = B[:, 3:, 3:] = w_T_b_hat[:, :3, :3]
    return np.einsum("nij,nj->ni", B, xi), B @ covariances @ B.transpose(0, 2, 1), B


def _of_block(rows: slice, xi: Array, P: Array, shared: Array) -> Consistency:
    whitened = _whiten(np.concatenate([xi[:, rows, None], shared[:, rows]], axis=2), P[:, rows, rows])
    return consistency(whitened[:, :, 0], np.moveaxis(whitened[:, :, 1:], 2, 0))


def consistency(whitened: Array, shared: Array | None = None) -> Consistency:
    """Mean NEES and its band from (n, dof) whitened errors in order of time.

    ``shared`` (s, n, dof), whitened alike, is one standard deviation of each error that the poses share.
    """
    n, dof = whitened.shape
    weights, of_weights = _mean_of_squares(whitened, np.zeros((0, n, dof)) if shared is None else shared)
    lower, upper = weighted_chi_square_interval(0.95, weights, of_weights)
    n_eff = dof / float(weights**2 @ of_weights)
    return Consistency(dof, float(np.sum(whitened**2) / n), lower, upper, n_eff)


def _mean_of_squares(whitened: Array, shared: Array) -> tuple[Array, Array]:
    """Weights (m,) and degrees of freedom (m,) of the chi-squares that sum to the mean of squares."""
    n, dof = whitened.shape
    U = shared.reshape(len(shared), n * dof)
    variance, mode = np.linalg.eigh(U @ U.T / n)
    known = variance > _SINGULAR
    along = mode[:, known].T @ U
    off = whitened - ((along @ whitened.ravel() / (n * variance[known])) @ along).reshape(n, dof)
    left = np.clip(1 - np.mean(np.sum(shared**2, axis=0), axis=0), _SINGULAR, 1.0)
    squares = float(left**2 @ _inflation(off, left)) / n
    weights = np.append(variance[known], squares / left.sum())
    return weights, np.append(np.ones(known.sum()), left.sum() ** 2 / squares)


def _inflation(sequence: Array, variance: Array) -> Array:
    """(dof,) by which the mean of squares of (n, dof) sequences scatters more than that of independent ones,
    in variance; between 1 and n."""
    n = len(sequence)
    if n == 1:
        return np.ones(len(variance))
    rho = np.clip(1 - 0.5 * np.mean(np.diff(sequence, axis=0) ** 2, axis=0) / variance, 0.0, 1.0)
    lag = np.arange(1, n)[:, None]
    return np.asarray(1 + 2 * np.sum((1 - lag / n) * rho ** (2 * lag), axis=0))


def _invertible(P: Array) -> bool:
    diagonal = np.diag(P)
    if not (np.isfinite(P).all() and (diagonal > 0).all()):
        return False
    scale = np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > _SINGULAR)


def _whiten(errors: Array, P: Array) -> Array:
    """Whiten columns of errors (n, d, s) of (n, d, d) covariances: each then has the unit covariance."""
    scale: Array = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # Radians and metres differ by orders of magnitude: factor the correlation matrices, not the covariances.
    factor = np.linalg.cholesky(P / (scale[:, :, None] * scale[:, None, :]))
    return np.asarray(np.linalg.solve(factor, errors / scale[:, :, None]), dtype=float)
