"""The homography between two pictures of a floor: robust fit, covariance, transfer.

``i_H_j`` takes undistorted pixels of picture j to pixels of picture i, as ``H_(i-1)i`` of the paper does
(section 3.1). Its uncertainty is told where one can picture it: as the 8x8 covariance in px² of the four
corners of picture j after transfer into picture i, (x0, y0, x1, y1, ...).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.points import Points

Array = NDArray[np.float64]

CAUCHY_SIGMAS = 4.45
"""Standard deviations at which a match counts half: 1 % of accuracy is lost where all errors are Gaussian."""
RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two coordinates have unit deviation."""
_START_PX = 0.3
"""What SIFT's positions usually err by, to begin with."""
_STILL_PX = 1e-4
"""A step that moves the picture by less ends the iteration."""


@dataclass(frozen=True)
class HomographyConfig:
    """Robust fit."""

    threshold_px: float = 3.0
    """epsilon of the paper: a match farther than this from its transfer is an outlier. For pictures of up to
    500 px; in wider ones it grows with the width, because relief moves points by a share of the picture."""
    max_iterations: int = 2000
    confidence: float = 0.9999
    score: Literal["magsac", "msac"] = "magsac"
    """MAGSAC++ asks for no exact threshold, but takes a blend of two motions a little apart for one; MSAC
    takes either."""
    noise_floor_px: float = 0.05
    """Feature positions are never believed better than this."""

    def for_width(self, width_px: int) -> HomographyConfig:
        """The same for pictures of a given width."""
        return replace(self, threshold_px=self.threshold_px * max(1.0, width_px / 500))


@dataclass(frozen=True)
class HomographyFit:
    """A homography with what is known of its quality."""

    i_H_j: Array
    """(3, 3), scaled to [2, 2] = 1."""
    corner_covariance: Array
    """(8, 8) px², of the corners of picture j transferred into picture i."""
    inlier: NDArray[np.bool_]
    """(m,) which matches agree."""
    noise_px: float
    """Standard deviation of one coordinate of a usual feature, as the residuals show it."""


def transfer(a_H_b: Array, pixel: Array) -> Array:
    """Pixels of b carried into a. (3, 3), (n, 2) -> (n, 2)."""
    h = np.asarray(pixel, dtype=float).reshape(-1, 2) @ a_H_b[:, :2].T + a_H_b[:, 2]
    return h[:, :2] / h[:, 2:]


def fit_homography(
    points_i: Points, points_j: Points, corners_px: Array, config: HomographyConfig = HomographyConfig()
) -> HomographyFit | None:
    """Robust fit refined on its inliers by weighted Gauss-Newton; None where no plane explains the matches.

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
    """Gauss-Newton on the inliers with Cauchy weights, then the covariance of the carried corners.

    Both pictures carry noise: the residual in i has covariance noise² (a² I + b² J J') with J the local
    derivative of H, a and b the points' own spreads; taken as isotropic, with half its trace.
    """
    noise, ridge = max(config.noise_floor_px, _START_PX), 1e-12 * np.eye(8)
    for _ in range(5):
        residual, jacobian, spread = _transfer_residuals(H, points_i, points_j)
        distance = np.sqrt(residual[:, 0] ** 2 + residual[:, 1] ** 2) / spread
        inlier = distance < config.threshold_px
        if np.count_nonzero(inlier) < 5:
            return None
        noise = max(config.noise_floor_px, _median(distance[inlier]) / RAYLEIGH_MEDIAN)
        robust = inlier / (1.0 + (distance / (CAUCHY_SIGMAS * noise)) ** 2)
        weight = np.sqrt(robust) / spread
        A = (jacobian * weight[:, None, None]).reshape(-1, 8)
        b = (residual * weight[:, None]).ravel()
        information = A.T @ A
        try:
            step = np.linalg.solve(information + ridge * information, A.T @ b)
        except np.linalg.LinAlgError:
            return None
        H = H + np.array([*step, 0.0]).reshape(3, 3)
        if not np.isfinite(H).all():
            return None
        if max(abs(step[2]), abs(step[5])) < _STILL_PX:
            break
    noise = max(
        config.noise_floor_px, _noise_of_estimate(distance[inlier], robust[inlier], CAUCHY_SIGMAS * noise)
    )
    corners = Points.alike(corners_px)
    _, corner_jacobian, _ = _transfer_residuals(H, corners, corners)
    C = corner_jacobian.reshape(8, 8)
    try:
        covariance = noise**2 * C @ np.linalg.solve(information / np.mean(robust[inlier]), C.T)
    except np.linalg.LinAlgError:
        return None
    covariance = 0.5 * (covariance + covariance.T)
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh(covariance)[0] <= 0:
        return None  # points on a line, or all in one place
    return HomographyFit(H, covariance, inlier, noise)


def _noise_of_estimate(distance: Array, robust: Array, scale_px: float) -> float:
    """Standard deviation of one coordinate that makes the covariance of least squares that of the robust fit.

    Distant matches are weighed down and so tell less, but those near by tell of the place what all of them
    together do. Source: Huber 1981, section 6.3 (asymptotic covariance of M-estimates), for Cauchy's weights
    and residuals of two coordinates.
    """
    told, pull = robust * distance, robust - (robust * distance / scale_px) ** 2
    spare = len(distance) / max(1.0, len(distance) - 4.0)
    return float(np.sqrt(0.5 * np.mean(told**2) * spare) / max(np.mean(pull), 0.1))


def _transfer_residuals(H: Array, points_i: Points, points_j: Points) -> tuple[Array, Array, Array]:
    """Residual (m, 2) in i, its Jacobian (m, 2, 8) for the first eight entries of H, its spread (m,)."""
    pixel_j = points_j.pixel
    u = pixel_j @ H[:, :2].T + H[:, 2]
    w = 1.0 / u[:, 2]
    p = u[:, :2] * w[:, None]
    first = np.empty((len(w), 3))
    first[:, :2], first[:, 2] = pixel_j * w[:, None], w
    J = np.zeros((len(w), 2, 8))
    J[:, 0, :3] = J[:, 1, 3:6] = first
    J[:, :, 6:] = -p[:, :, None] * first[:, None, :2]
    # Local scale of the map j -> i: mean squared size of d p / d pixel_j.
    local = (H[None, :2, :2] - p[:, :, None] * H[None, 2:, :2]) * w[:, None, None]
    spread = np.sqrt(points_i.spread**2 + 0.5 * np.einsum("nij,nij->n", local, local) * points_j.spread**2)
    return points_i.pixel - p, J, spread


def _median(values: Array) -> float:
    """As numpy's, which takes longer to look for NaN than to find it."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    below, above = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float((below + above) / 2)
