"""Consistency of covariances: the normalised estimation error squared (NEES).

Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.
For ``xi = Log(w_T_b_hat^-1 w_T_b_true)`` of covariance P, ``xi' P^-1 xi`` is chi-square with 6 degrees of
freedom. Its mean over keyframes is 6 where the covariances are right, and larger where they are too small.

Band of that mean: errors of neighbouring keyframes are nearly equal, so n keyframes count as far fewer
independent ones. The textbook band (chi-square with 6 n degrees) would reject a consistent estimate nearly
always. Here each of the six whitened errors z is modelled as a first-order Markov sequence, the typical error
of integrated odometry plus measurement noise. Under the tested hypothesis z has unit variance, so the mean
squared step between neighbours gives its correlation: ``rho = 1 - E[(z_k+1 - z_k)^2] / 2``. For Gaussian z
the squares correlate as rho^(2 lag). The variance of the mean is then ``12 / n_eff`` with ``n_eff = n / mean
over the six of [1 + 2 sum_lag (1 - lag/n) rho^(2 lag)]``. The band is that of a chi-square with ``6 n_eff``
degrees divided by n_eff (Satterthwaite's match of mean and variance). Over simulated Markov, random-walk and
pinned-walk errors it holds 89.7 to 97 % of the time. For much smoother errors it is wider than necessary.

An error common to all poses is no such sequence. A wrong scale moves each pose along the vector from the
first one to it. Where the path turns, neighbours differ in that error, and distant poses still share it.
Where its standard deviation u_k is given (whitened as z is), ``z_k = s u_k + r_k`` with one number s. Squares
correlate as ``|u_k|^2 |u_l|^2`` at any distance, and r is the sequence, of variance ``1 - u_k^2`` in each
component. Over winding paths whose errors are mostly scale, this band of positions holds 96 % of the time;
modelled as an ordinary sequence it would hold 87 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from backend.quantiles import chi_square_quantile

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
    """Number of independent keyframes that carry the same evidence."""

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


def nees(w_T_b_hat: Array, w_T_b_true: Array, covariances: Array, common: Array | None = None) -> Nees | None:
    """Compute the NEES of (n, 4, 4) poses in order of time with their (n, 6, 6) covariances.

    All poses must have one gauge. The pose that fixes it must not be among them: its error is zero by
    construction. ``common`` (n, 6), rotation first, in world axes, is the shift of each pose by one standard
    deviation of an error that all poses share. The result is None where no covariance is usable.
    """
    xi_w, P_w = world_errors(w_T_b_hat, w_T_b_true, covariances)
    usable = np.array([_invertible(P) for P in P_w], dtype=bool)
    if not usable.any():
        return None
    xi_w, P_w = xi_w[usable], P_w[usable]
    shared = np.zeros_like(xi_w) if common is None else common[usable]
    whitened = _whiten(xi_w, P_w)
    per_keyframe = np.full(len(usable), np.nan)
    per_keyframe[usable] = np.sum(whitened**2, axis=1)
    return Nees(
        pose=consistency(whitened, _whiten(shared, P_w)),
        position=_of_block(slice(3, 6), xi_w, P_w, shared),
        rotation=_of_block(slice(0, 3), xi_w, P_w, shared),
        per_keyframe=per_keyframe,
        left_out=int((~usable).sum()),
    )


def world_errors(w_T_b_hat: Array, w_T_b_true: Array, covariances: Array) -> tuple[Array, Array]:
    """Right perturbations (n, 6) and their covariances (n, 6, 6), both rotated to world axes.

    The NEES is the same in any axes. In world axes a turn of the vehicle does not hide that the errors before
    and after it are one error.
    """
    xi = RigidTransform.from_matrix(np.linalg.inv(w_T_b_hat) @ w_T_b_true).as_exp_coords()
    B = np.zeros((len(xi), 6, 6))
    B[:, :3, :3] = B[:, 3:, 3:] = w_T_b_hat[:, :3, :3]
    return np.einsum("nij,nj->ni", B, xi), B @ covariances @ B.transpose(0, 2, 1)


def _of_block(rows: slice, xi: Array, P: Array, shared: Array) -> Consistency:
    P = P[:, rows, rows]
    return consistency(_whiten(xi[:, rows], P), _whiten(shared[:, rows], P))


def consistency(whitened: Array, shared: Array | None = None) -> Consistency:
    """Mean NEES and its band from (n, dof) whitened errors in order of time.

    ``shared`` (n, dof), whitened alike, is one standard deviation of the error that all poses share.
    """
    n, dof = whitened.shape
    n_eff = effective_count(whitened, np.zeros_like(whitened) if shared is None else shared)
    lower, upper = (chi_square_quantile(quantile, dof * n_eff) / n_eff for quantile in (0.025, 0.975))
    return Consistency(dof, float(np.sum(whitened**2) / n), lower, upper, n_eff)


def effective_count(whitened: Array, shared: Array) -> float:
    """Number of independent samples that (n, dof) whitened errors are equivalent to; between 1 and n."""
    n, dof = whitened.shape
    if n == 1:
        return 1.0
    total = float(np.sum(shared**2))
    rest = whitened - (np.sum(shared * whitened) / total if total > 0 else 0.0) * shared
    variance = np.clip(1 - np.mean(shared**2, axis=0), _SINGULAR, 1.0)
    rho = np.clip(1 - 0.5 * np.mean(np.diff(rest, axis=0) ** 2, axis=0) / variance, 0.0, 1.0)
    lag = np.arange(1, n)[:, None]
    inflation = 1 + 2 * np.sum((1 - lag / n) * rho ** (2 * lag), axis=0)
    together = min(total / n, 1.0) ** 2
    return float(dof / (together + np.sum(variance**2 * inflation) / n))


def _invertible(P: Array) -> bool:
    diagonal = np.diag(P)
    if not (np.isfinite(P).all() and (diagonal > 0).all()):
        return False
    scale = np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(P / np.outer(scale, scale))[0] > _SINGULAR)


def _whiten(xi: Array, P: Array) -> Array:
    """Whiten errors of (n, d, d) covariances: (n, d) errors of unit covariance."""
    scale: Array = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    # Radians and metres differ by orders of magnitude: factor the correlation matrices, not the covariances.
    factor = np.linalg.cholesky(P / (scale[:, :, None] * scale[:, None, :]))
    return np.asarray(np.linalg.solve(factor, (xi / scale)[:, :, None])[:, :, 0], dtype=float)
