"""Factor of a homography over the floor: where four points of one picture lie in another.

Both cameras stand over the floor at z = 0, in mean heights. The floor under two pictures may slope a little,
because of its relief. This slope is marginalised: a homography then tells nothing about the tilt of the pair.

Source: Hartley and Zisserman 2004, section 13.1 (homography of a plane); Jacobians derived.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.se3 import cross_matrix, exp
from backend.whitening import whitening

Array = NDArray[np.float64]

POINTS = 4
ROWS = 2 * POINTS
"""Numbers of a homography."""
_SLOPE_STD_RAD = 0.05
"""Standard deviation of the slope of the floor under a pair: as that of the ground in `BundleConfig`."""
_STEPS = 5
"""Gauss-Newton steps from the pose of the keyframe: points move almost linearly with the pose."""


@dataclass(frozen=True)
class ImagePlane:
    """Focal lengths and principal point, (2,) each."""

    focal_px: Array
    center_px: Array

    def rays(self, pixel: Array) -> Array:
        """Return directions (..., 3) of pixels (..., 2) in camera axes, at depth 1."""
        xy = (pixel - self.center_px) / self.focal_px
        return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)


@dataclass(frozen=True)
class TransferredPoints:
    """Points of m pictures in their keyframes, with derivatives."""

    pixel: Array
    """(m, 8)."""
    by_keyframe: Array
    """(m, 8, 6) by the right perturbation of the pose, rotation first."""
    by_frame: Array
    """(m, 8, 6)."""
    by_slope: Array
    """(m, 8, 2) by the slope of the floor along x and y about the keyframe's nadir."""


def transfer(f_T_k: Array, f_T_j: Array, rays: Array, plane: ImagePlane) -> TransferredPoints:
    """Transfer points of pictures j at poses (m, 4, 4) to keyframes k; ``rays`` (m, 4, 3) show them in j."""
    f_R_k, f_R_j = f_T_k[:, :3, :3], f_T_j[:, :3, :3]
    ray = rays @ np.swapaxes(f_R_j, 1, 2)
    along = ray / ray[..., 2:]
    depth = -f_T_j[:, None, 2, 3] / ray[..., 2]
    point = f_T_j[:, None, :3, 3] - f_T_j[:, None, 2:3, 3] * along
    k_p = (point - f_T_k[:, None, :3, 3]) @ f_R_k
    xy = k_p[..., :2] / k_p[..., 2:]
    by_k_p = np.zeros((*xy.shape, 3))
    by_k_p[..., 0, 0] = by_k_p[..., 1, 1] = 1.0
    by_k_p[..., 2] = -xy
    by_k_p *= plane.focal_px[:, None] / k_p[..., None, 2:]
    by_point = by_k_p @ np.swapaxes(f_R_k, 1, 2)[:, None]
    by_height = np.einsum("mkab,mkb->mka", by_point, along)
    # A motion of the ray moves the point along the floor alone.
    moved = (by_point - by_height[..., None] * [0.0, 0.0, 1.0]) @ f_R_j[:, None]
    away = point[..., :2] - f_T_k[:, None, :2, 3]
    return TransferredPoints(
        pixel=_rows(xy * plane.focal_px + plane.center_px),
        by_keyframe=_rows(np.concatenate([by_k_p @ cross_matrix(k_p), -by_k_p], axis=-1)),
        by_frame=_rows(
            np.concatenate([-depth[..., None, None] * moved @ cross_matrix(rays), moved], axis=-1)
        ),
        by_slope=_rows(by_height[..., None] * away[..., None, :]),
    )


def _rows(by_point: Array) -> Array:
    """Join the coordinates of the points (m, 4, 2, ...) to rows (m, 8, ...)."""
    return by_point.reshape(len(by_point), ROWS, *by_point.shape[3:])


def place(f_T_k: Array, rays: Array, pixel: Array, plane: ImagePlane) -> Array:
    """Return poses (m, 4, 4) of pictures whose ``rays`` are seen at ``pixel`` (m, 8) of the keyframes."""
    f_T_j = f_T_k
    for _ in range(_STEPS):
        found = transfer(f_T_k, f_T_j, rays, plane)
        step = np.einsum("mab,mb->ma", np.linalg.pinv(found.by_frame), pixel - found.pixel)
        f_T_j = f_T_j @ exp(step)
    return f_T_j


def homography_whitening(covariance: Array, by_slope: Array) -> Array:
    """Return the matrix (8, 8) that whitens the error, for the covariance of the points in the keyframe."""
    return whitening(covariance + _SLOPE_STD_RAD**2 * by_slope @ by_slope.T)


def homography_factor(
    keys: tuple[int, int],
    rays: Array,
    pixel: Array,
    plane: ImagePlane,
    whitening: Array,
    model: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """Return the factor of the poses of a keyframe and a picture (``keys``); its error (8,) is whitened.

    ``rays`` (4, 3) of the picture are seen at ``pixel`` (8,) of the keyframe. ``model`` is a unit model, or a
    robust one of it.
    """

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        f_T_k, f_T_j = (values.atPose3(key).matrix()[None] for key in keys)
        found = transfer(f_T_k, f_T_j, rays[None], plane)
        if jacobians is not None:
            jacobians[0], jacobians[1] = whitening @ found.by_keyframe[0], whitening @ found.by_frame[0]
        return np.asarray(whitening @ (found.pixel[0] - pixel))

    return gtsam.CustomFactor(model, list(keys), error)
