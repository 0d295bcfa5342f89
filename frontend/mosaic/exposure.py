"""Joint estimation of the exposure gain of each picture and the vignetting of the lens from all overlaps.

The model for floor point p in picture i is log I_ip = m_p - g_i - a1 rho^2 - a2 rho^4 + noise, for each
channel. m_p is the log brightness of the floor, g_i the log gain that compensates the picture, and rho the
distance from the principal point, 1 at the farthest corner. Least squares with Huber weights solves for all
points at once; m_p is eliminated, as it is a weighted mean. Priors g ~ 0 and a ~ 0 constrain what the
overlaps do not determine.

Source: Brown and Lowe 2007, Automatic panoramic image stitching using invariant features, section 6
(gains over overlaps with a prior towards 1), here in logs so that the system is linear; Goldman 2010,
Vignette and exposure calibration and compensation (even polynomial for the vignetting).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

Array = NDArray[np.float64]

SAMPLE_STD = 0.1
"""Standard deviation of one log brightness: patches are small, shifted by a pixel, and correlated with their
neighbours."""
GAIN_STD = 0.2
VIGNETTE_STD = 0.3
HUBER = 0.1
GAIN_LIMIT = 2.5
GAIN_STEP, VIGNETTE_STEP = 1 / 256, 1 / 128
"""Steps to which the logarithms are rounded, at most one grey level. A change elsewhere in the mosaic then
leaves them bitwise equal."""
ROUNDS = 5


@dataclass(frozen=True)
class Samples:
    """Brightness of floor points in the pictures that see them, one row per observation."""

    point: NDArray[np.int64]
    """(m,) number of the floor point."""
    view: NDArray[np.int64]
    """(m,) number of the picture."""
    rho2: Array
    """(m,) squared distance from the principal point; 1 at the farthest corner."""
    log_bgr: Array
    """(m, 3) natural logarithm of the mean grey levels around the point."""


@dataclass(frozen=True)
class Exposure:
    """Factors that the pictures are multiplied by."""

    gain: Array
    """(views, 3) gains of blue, green, red."""
    vignette: Array
    """(2, 3): corrected = read * gain * exp(vignette[0] rho^2 + vignette[1] rho^4)."""
    seam_before: float
    """Root mean square brightness difference between pictures of one point, as a share of the brightness."""
    seam_after: float
    point: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    """(p,) numbers of the floor points that two or more pictures see."""
    point_seam: Array = field(default_factory=lambda: np.empty(0))
    """(p,) ``seam_after`` of each point."""

    @staticmethod
    def neutral(views: int) -> Exposure:
        """Return gains of 1 and no vignetting."""
        return Exposure(np.ones((views, 3)), np.zeros((2, 3)), float("nan"), float("nan"))


def estimate_exposure(samples: Samples, views: int) -> Exposure:
    """Estimate the gains of ``views`` pictures and their common vignetting."""
    count = np.bincount(samples.point)
    shared = count[samples.point] > 1
    if not shared.any():
        return Exposure.neutral(views)
    number, point = np.unique(samples.point[shared], return_inverse=True)
    view, rho2, y = samples.view[shared], samples.rho2[shared], samples.log_bgr[shared]
    m = len(y)
    gains = sparse.csr_matrix((np.ones(m), (np.arange(m), view)), (m, views))
    X = sparse.hstack([gains, sparse.csr_matrix(np.column_stack([rho2, rho2**2]))], format="csr")
    B = sparse.csr_matrix((np.ones(m), (np.arange(m), point)))
    prior = np.full(views + 2, (SAMPLE_STD / GAIN_STD) ** 2)
    prior[views:] = (SAMPLE_STD / VIGNETTE_STD) ** 2
    theta = np.zeros((views + 2, 3))
    weight = np.ones(m)
    before = _rms_difference(y, B, np.ones(m))
    for _ in range(ROUNDS):
        W = sparse.diags_array(weight)
        mean = sparse.diags_array(1 / np.asarray(B.T @ weight))
        C = B.T @ W @ X
        normal = X.T @ W @ X - C.T @ mean @ C + sparse.diags_array(prior)
        right = -(X.T @ (W @ y) - C.T @ (mean @ (B.T @ (W @ y))))
        theta = spsolve(normal.tocsc(), right).reshape(views + 2, 3)
        residual = _residual(y + X @ theta, B, weight)
        size = np.sqrt((residual**2).mean(axis=1))
        weight = np.minimum(1, HUBER / np.maximum(size, 1e-9))
    step = np.full((views + 2, 1), GAIN_STEP)
    step[views:] = VIGNETTE_STEP
    theta = np.round(theta / step) * step
    gain = np.clip(np.exp(theta[:views]), 1 / GAIN_LIMIT, GAIN_LIMIT)
    corrected = y + X @ theta
    after = _rms_difference(corrected, B, np.ones(m))
    return Exposure(gain, theta[views:], before, after, number, _rms_difference_of_points(corrected, B))


def _residual(y: Array, B: sparse.csr_matrix, weight: Array) -> Array:
    """Return the difference of each observation from the weighted mean of its point."""
    mean = (B.T @ (weight[:, None] * y)) / (B.T @ weight)[:, None]
    return np.asarray(y - B @ mean)


def _rms_difference_of_points(y: Array, B: sparse.csr_matrix) -> Array:
    """Return the root mean square difference of two observations for each point."""
    residual = _residual(y.mean(axis=1, keepdims=True), B, np.ones(len(y)))[:, 0]
    return np.asarray(np.sqrt(2 * (B.T @ residual**2) / (B.T @ np.ones(len(y)) - 1)), dtype=float)


def _rms_difference(y: Array, B: sparse.csr_matrix, weight: Array) -> float:
    """Return the root mean square difference of the grey brightness of two observations of one point."""
    residual = _residual(y.mean(axis=1, keepdims=True), B, weight)
    dof = len(y) - B.shape[1]
    return float(np.sqrt(2 * (residual**2).sum() / max(dof, 1)))
