"""Shares of the instruments in the errors of a refined map, direction by direction.

With the whitened Jacobian A and the covariance S of all variables, the variance of a quantity g'x is
g'Sg = |A S g|^2. The squares of the rows that belong to one instrument are the variance that its noise
contributes. An estimate follows its instruments in inverse proportion to their variances, so that a large
share means a large weight.

Source: Förstner and Wrobel 2016, section 4.2.3 (propagation of the observations' covariance).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.accuracy.ground_covariances import SeenGround, ground_jacobians
from backend.bundle.accuracy.ground_size import gradients
from backend.bundle.factors import LOG_SCALE, WORLD
from backend.bundle.metric_poses import metric_jacobians, metric_poses, over_floor_jacobians
from backend.bundle.minimise import BundleOptimum

Array = NDArray[np.float64]

DIRECTIONS = ("roll", "pitch", "yaw", "x", "y", "z", "scale", "height", "ground")
_POSE, _SCALE, _HEIGHT, _GROUND = slice(0, 6), 6, slice(7, 8), slice(8, 14)
"""Columns of the gradient. The motion of the body that moves the ground in its picture has six."""


def information_shares(optimum: BundleOptimum) -> Mapping[str, Mapping[str, float]]:
    """Return for each direction the share of each instrument in the variance; shares add up to 1.

    Directions are the pose of the keyframe farthest from the first one, translated along the world's axes and
    rotated about the body's, the scale of all lengths on the ground, the height of that keyframe over the
    ground, and the place of the ground in its picture, x and y together, in the mean over the picture. Priors
    on an instrument's errors belong to the instrument. What remains is ``assumed``, and the assumption that
    the floor is flat is ``flat_floor``.

    Raises ``SingularMatrixError`` if a direction is open.
    """
    linear, reduced = optimum.eliminated()
    columns = reduced.structure.columns
    k, of_pose = _farthest(optimum)
    gradient = np.zeros((reduced.size, _GROUND.stop))
    keys = (POSE(k), WORLD, *((CALIBRATION(0),) if optimum.problem.self_calibrates else ()))
    at = np.r_[tuple(columns(key) for key in keys)]
    for quantities, J in (
        (_POSE, of_pose),
        (_HEIGHT, _height_jacobian(optimum, k)),
        (_GROUND, ground_jacobians(optimum)[k]),
    ):
        gradient[at[: J.shape[1]], quantities] = J.T
    of_points = np.zeros((optimum.at.point.size, gradient.shape[1]))
    if optimum.problem.has_scale:
        gradient[:, _SCALE], of_points[:, _SCALE] = (each[:, 0] for each in gradients(optimum, reduced))
    else:  # What is fixed in place of a length says all.
        gradient[columns(WORLD).start + LOG_SCALE, _SCALE] = 1.0
    pictures, floor = ["pictures"] * optimum.cost.observations.pixel.size, ["flat_floor"] * len(of_points)
    instrument = np.array([*pictures, *floor, *optimum.cost.pose_side.instruments])
    names, number = np.unique(instrument, return_inverse=True)
    products = np.zeros((len(names), _GROUND.stop, _GROUND.stop))
    for rows, part in linear.products(*reduced.solve(gradient, of_points)):
        for each in np.unique(number[rows]):
            mine = part[number[rows] == each]
            products[each] += mine.T @ mine
    variance = _variances(products, optimum, k)
    shares = (variance / variance.sum(axis=0)).T
    by_name = (dict(zip(names.tolist(), row, strict=True)) for row in shares.tolist())
    return dict(zip(DIRECTIONS, by_name, strict=True))


def _height_jacobian(optimum: BundleOptimum, k: int) -> Array:
    """Return the Jacobian (1, 6 + w) of the height of keyframe k over the floor."""
    problem, values = optimum.problem, optimum.values
    c_T_b = problem.transform(values).c_T_b
    f_R_b = values.atPose3(POSE(k)).compose(c_T_b).rotation().matrix()
    return np.asarray(f_R_b[2:] @ over_floor_jacobians(problem, values)[k, 3:])


def _variances(products: Array, optimum: BundleOptimum, k: int) -> Array:
    """Return the variances (i, directions) by the products (i, c, c) of each instrument's rows of the columns
    of the gradient."""
    J, before = SeenGround.of(optimum).jacobian(k), _GROUND.start
    in_mean = np.einsum("ra,iab,rb->i", J, products[:, _GROUND, _GROUND], J, optimize=True)
    squares = np.diagonal(products, axis1=1, axis2=2)
    return np.column_stack([squares[:, :before], in_mean])


def _farthest(optimum: BundleOptimum) -> tuple[int, Array]:
    """Return the keyframe farthest from the first one, and the Jacobian (6, 6 + w) of its metric pose."""
    problem, values = optimum.problem, optimum.values
    w_T_b = metric_poses(problem, values)
    k = int(np.argmax(np.linalg.norm(w_T_b[:, :3, 3] - w_T_b[0, :3, 3], axis=1)))
    J = metric_jacobians(problem, values)[k]
    J[3:] = w_T_b[k, :3, :3] @ J[3:]
    return k, J
