"""The homography between two pictures of a floor: robust fit, covariance, transfer.

``i_H_j`` takes undistorted pixels of picture j to pixels of picture i, as ``H_(i-1)i`` of the paper does
(section 3.1). Its uncertainty is expressed as the 8x8 covariance in px² of the four corners of picture j
after transfer into picture i, (x0, y0, x1, y1, ...).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dpotrf

from frontend.points import Points
from frontend.robust import median

Array = NDArray[np.float64]

CAUCHY_SIGMAS = 4.45
"""Standard deviations at which a match has half weight; 1 % of accuracy is lost where errors are Gaussian."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two coordinates have unit standard deviation."""
_START_PX = 0.3
"""Initial noise: the usual position error of SIFT."""
_STILL_PX = 1e-4
"""The iteration ends when a step moves the picture by less than this."""


@dataclass(frozen=True)
class HomographyConfig:
    """Parameters of the robust fit."""

    threshold_px: float = 3.0
    """epsilon of the paper: a match farther than this from its transfer is an outlier. For pictures of up to
    500 px; in wider ones it grows with the width, because relief moves points by a share of the picture."""
    max_iterations: int = 2000
    confidence: float = 0.9999
    score: Literal["magsac", "msac"] = "magsac"
    """MAGSAC++ needs no exact threshold, but may fit a blend of two similar motions; MSAC selects one of
    them."""
    noise_floor_px: float = 0.05
    """Lower bound of the noise of feature positions."""

    def for_width(self, width_px: int) -> HomographyConfig:
        """Return the configuration for pictures of a given width."""
        return replace(self, threshold_px=self.threshold_px * max(1.0, width_px / 500))


@dataclass(frozen=True)
class HomographyFit:
    """A homography with its covariance, inliers and noise."""

    i_H_j: Array
    """(3, 3), scaled to [2, 2] = 1."""
    corner_covariance: Array
    """(8, 8) px², of the corners of picture j transferred into picture i."""
    inlier: NDArray[np.bool_]
    """(m,) whether each match is an inlier."""
    noise_px: float
    """Standard deviation of one coordinate of a typical feature, estimated from the residuals."""


def transfer(a_H_b: Array, pixel: Array) -> Array:
    """Transfer pixels of b into a. (3, 3), (n, 2) -> (n, 2)."""
    h = np.asarray(pixel, dtype=float).reshape(-1, 2) @ a_H_b[:, :2].T + a_H_b[:, 2]
    return h[:, :2] / h[:, 2:]


def fit_homography(
    points_i: Points, points_j: Points, corners_px: Array, config: HomographyConfig = HomographyConfig()
) -> HomographyFit | None:
    """Fit robustly, then refine on the inliers by weighted Gauss-Newton; None where no plane fits the
    matches.

    ``points_i``, ``points_j``: m matched points; ``corners_px``: (4, 2) corners of picture j.
    Source: Barath et al. 2020 (MAGSAC++); Hartley and Zisserman 2004, sections 4.3 and 5.2 (covariance).
    """
    if len(points_i) < 4:
        return None
    params = cv2.UsacParams()
    params.threshold = config.threshold_px
    params.maxIterations = config.max_iterations
    params.confidence = config.confidence
    params.score = cv2.SCORE_METHOD_MAGSAC if config.score == "magsac" else cv2.SCORE_METHOD_MSAC
    params.sampler = cv2.SAMPLING_UNIFORM
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    params.loSampleSize = 50
    params.randomGeneratorState = 0
    try:
        H, mask = cv2.findHomography(points_j.pixel[:, None], points_i.pixel[:, None], params)
    except cv2.error:
        return None
    if H is None or mask is None or not np.isfinite(H).all() or abs(H[2, 2]) < 1e-12:
        return None
    inlier = mask.ravel().astype(bool)
    if inlier.sum() < 5:
        return None
    return _refine(H / H[2, 2], points_i, points_j, inlier, corners_px, config)


def _refine(
    H: Array,
    points_i: Points,
    points_j: Points,
    inlier: NDArray[np.bool_],
    corners_px: Array,
    config: HomographyConfig,
) -> HomographyFit | None:
    """Run Gauss-Newton on the inliers with Cauchy weights, then compute the covariance of the transferred
    corners.

    Both pictures are noisy: the residual in i has covariance noise² (a² I + b² J J') with J the local
    derivative of H, a and b the spreads of the points. It is approximated as isotropic, with half its trace.
    """
    noise, ridge = max(config.noise_floor_px, _START_PX), 1e-12 * np.eye(8)
    seen_i, seen_j = np.ascontiguousarray(points_i.pixel.T), _homogeneous(points_j.pixel)
    variance_i, half_variance_j = points_i.spread**2, 0.5 * points_j.spread**2
    for _ in range(5):
        p, first = _transferred(H, seen_j)
        residual = seen_i - p
        variance = variance_i + half_variance_j * _local_size(H, p, first[2])
        distance = np.sqrt((residual[0] ** 2 + residual[1] ** 2) / variance)
        inlier = distance < config.threshold_px
        if np.count_nonzero(inlier) < 5:
            return None
        noise = max(config.noise_floor_px, median(distance[inlier]) / RAYLEIGH_MEDIAN)
        robust = inlier / (1.0 + (distance / (CAUCHY_SIGMAS * noise)) ** 2)
        information, gradient = _normal_equations(p, first, residual, robust / variance)
        # LAPACK directly: numpy spends more time on checks than on solving for eight unknowns.
        _, step, failed = dposv(information + ridge * information, gradient)
        if failed:
            return None
        H = H + np.array([*step, 0.0]).reshape(3, 3)
        if not np.isfinite(H).all():
            return None
        if max(abs(step[2]), abs(step[5])) < _STILL_PX:
            break
    noise = max(
        config.noise_floor_px, _noise_of_estimate(distance[inlier], robust[inlier], CAUCHY_SIGMAS * noise)
    )
    C = jacobian(*_transferred(H, _homogeneous(corners_px)))
    _, shares, failed = dposv(information / np.mean(robust[inlier]), C.T)
    covariance = noise**2 * C @ shares
    covariance = 0.5 * (covariance + covariance.T)
    if failed or not np.isfinite(covariance).all() or dpotrf(covariance)[1]:
        return None  # collinear or coincident points
    return HomographyFit(H, covariance, inlier, noise)


def _noise_of_estimate(distance: Array, robust: Array, scale_px: float) -> float:
    """Return the std of one coordinate for which the least-squares covariance equals that of the robust fit.

    The correction accounts for the smaller weights of distant matches. Source: Huber 1981, section 6.3
    (asymptotic covariance of M-estimates), for Cauchy's weights and residuals of two coordinates.
    """
    score, slope = robust * distance, robust - (robust * distance / scale_px) ** 2
    correction = len(distance) / max(1.0, len(distance) - 4.0)
    return float(np.sqrt(0.5 * np.mean(score**2) * correction) / max(np.mean(slope), 0.1))


def _homogeneous(pixel: Array) -> Array:
    """Return homogeneous coordinates (3, m) of pixels (m, 2)."""
    homogeneous = np.ones((3, len(pixel)))
    homogeneous[:2] = pixel.T
    return homogeneous


def _transferred(H: Array, seen_j: Array) -> tuple[Array, Array]:
    """Transfer pixels (3, m) of j to (2, m) in i; also return the derivative (3, m) by a row of H but the
    last."""
    u = H @ seen_j
    first = seen_j / u[2]
    return u[:2] / u[2], first


def _local_size(H: Array, p: Array, w: Array) -> Array:
    """Return (m,) the squared Frobenius norm of d p / d pixel_j, the local scale of the map j -> i."""
    local = H[:2, :2, None] - p[:, None] * H[2, :2, None]
    return np.asarray(np.einsum("abm,abm->m", local, local) * w**2)


def _normal_equations(p: Array, first: Array, residual: Array, weight: Array) -> tuple[Array, Array]:
    """Return the information matrix (8, 8) of the first eight entries of H and the right-hand side (8,).

    Row u of a point's Jacobian is (first, 0, -p_u first), row v (0, first, -p_v first): all products of the
    two are among those of seven columns.
    """
    G = np.empty((7, first.shape[1]))
    G[:3], G[3:5], G[5:] = first, -p[0] * first[:2], -p[1] * first[:2]
    weighted = G * weight
    S, t = weighted @ G.T, weighted @ residual.T
    information = np.zeros((8, 8))
    information[:3, :3] = information[3:6, 3:6] = S[:3, :3]
    information[:3, 6:], information[3:6, 6:] = S[:3, 3:5], S[:3, 5:]
    information[6:, :3], information[6:, 3:6] = S[3:5, :3], S[5:, :3]
    information[6:, 6:] = S[3:5, 3:5] + S[5:, 5:]
    return information, np.concatenate([t[:3, 0], t[:3, 1], t[3:5, 0] + t[5:, 1]])


def jacobian(p: Array, first: Array) -> Array:
    """Return the Jacobian (2 m, 8) of transferred points ``p`` (2, m) px, u and v in turn, by eight entries
    of H.

    ``first`` (3, m) is (x, y, 1) of the source point over the third coordinate of its transfer.
    """
    J = np.zeros((len(p.T), 2, 8))
    J[:, 0, :3] = J[:, 1, 3:6] = first.T
    J[:, :, 6:] = -p.T[:, :, None] * first.T[:, None, :2]
    return J.reshape(-1, 8)
