"""Gates that reject unreliable homographies: the two gates of the paper and five more."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from backend.measurements import LinkCheck, Rejection
from frontend.camera import Camera
from frontend.homography import HomographyFit, transfer

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GateConfig:
    """Limits of an acceptable registration."""

    max_outlier_share: float = 0.8
    """gamma_1 of the paper (section 3.1)."""
    max_relative_change: float = 2.5
    """gamma_2 of the paper (section 3.1, equation 2); 1 is no change, half a turn comes to 1.6."""
    min_inliers: int = 15
    min_spread: float = 0.03
    """Least share of the picture inside the convex hull of the inliers."""
    max_corner_std: float = 0.03
    """Largest standard deviation of a transferred corner, in picture widths."""
    max_scale: float = 3.5
    """Largest ratio of heights."""
    min_overlap: float = 0.1
    """Least overlap of the pictures; measured in the lower picture where heights differ much."""


def reject_reason(
    fit: HomographyFit, pixel_j: Array, camera: Camera, overlap: float, gates: GateConfig
) -> Rejection | None:
    """Return the reason for rejecting the fit; None where it is accepted.

    ``pixel_j`` (m, 2): all matches, inliers or not; ``overlap``: overlap of the pictures as a share.
    """
    inliers = int(fit.inlier.sum())
    if inliers < gates.min_inliers:
        return Rejection(LinkCheck.TOO_FEW_INLIERS)
    if 1.0 - inliers / len(fit.inlier) > gates.max_outlier_share:
        return Rejection(LinkCheck.OUTLIER_SHARE)
    if overlap < gates.min_overlap:
        return Rejection(LinkCheck.OVERLAP)
    scale = local_scale(fit.i_H_j, camera)
    if not 1.0 / gates.max_scale < scale < gates.max_scale:
        return Rejection(LinkCheck.SCALE)
    w, h = camera.size_px
    hull = cv2.convexHull(pixel_j[fit.inlier].astype(np.float32))
    if cv2.contourArea(hull) < gates.min_spread * w * h:
        return Rejection(LinkCheck.CROWDED)
    std = float(np.sqrt(np.diag(fit.corner_covariance).max()))
    if not std < gates.max_corner_std * w * max(1.0, scale):
        return Rejection(LinkCheck.PRECISION)
    return None


def local_scale(i_H_j: Array, camera: Camera) -> float:
    """Return the scale of the centre of picture j in picture i."""
    w, h = camera.size_px
    c = np.array([(w - 1) / 2, (h - 1) / 2])
    p = transfer(i_H_j, np.array([c, c + [1.0, 0], c + [0, 1.0]]))
    (a, b), (c, d) = p[1:] - p[0]
    return float(np.sqrt(abs(a * d - b * c)))


def relative_change(i_H_j: Array, camera: Camera) -> float:
    """Return the mean |delta H| of equation 2: the change of the global transformation by a new local one.

    The printed formula divides the old homography by the new one element by element. It is unbounded wherever
    an element passes through zero: every translation does, and all elements do where a long flight crosses
    the horizon of a tilted first picture. Here the old picture is the canvas, elements are in picture widths,
    where 1 is the natural size of each, and 1 + |old - new| replaces the ratio. An unchanged homography gives
    1.
    """
    size = np.array([camera.size_px[0], camera.size_px[0], 1.0])
    local = i_H_j * size / size[:, None]
    return float(1.0 + np.abs(local / local[2, 2] - np.eye(3)).mean())
