"""Custom factors: metric measurements of poses that are in units of the mean height above the floor.

The frame of the pictures has the floor at z = 0 and the mean height as its unit. One variable of eight
numbers, (log s, f, log g, d, a, b, m, n), maps it to the measured world. A camera pose (R, p) has the
position s A p + (0, 0, f) there and is rotated by A = Exp(a, b, 0), the slope of the floor. The rangefinder
reads g times the range plus d, its zero offset. The mount of the camera is the nominal one rotated by
M = Exp(m, n, 0) about the camera's axes: a direction fixed to the body is rotated by M' in camera axes.

gtsam crashes on a custom factor with missing or ill-shaped Jacobians; these always return them.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.se3 import cross_matrix

Array = NDArray[np.float64]

LOG_SCALE, FLOOR_Z, LOG_GAIN, DATUM, SLOPE, MOUNT = 0, 1, 2, 3, slice(4, 6), slice(6, 8)
"""Index of each number in the world variable."""
WORLD_SIZE = 8


def rotation_of(world: Array, which: slice) -> Array:
    """Return the rotation (3, 3) of the slope or the mount of a world variable."""
    return gtsam.Rot3.Rodrigues(np.array([*world[which], 0.0])).matrix()


def rotation_jacobian(world: Array, which: slice) -> Array:
    """Return the Jacobian (3, 2) of that rotation, as a right perturbation, by its two numbers."""
    return gtsam.Rot3.ExpmapDerivative(np.array([*world[which], 0.0]))[:, :2]


def scaled_range_factor(
    pose_key: int, world_key: int, range_m: float, model: gtsam.noiseModel.Base, c_T_s: Array
) -> gtsam.CustomFactor:
    """Return the factor of a slant range along the sensor's -z axis to the floor: g s z / R33 + d - range.

    With ``r`` the third row of R, ``u`` the sensor's z axis and ``t`` its origin in camera axes: the
    sensor's z is s p_z + r t and R33 = r u; a right perturbation w turns r into r - w x r. Source: derived.
    """

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, world = values.atPose3(pose_key), values.atVector(world_key)
        scale, gain = np.exp(world[LOG_SCALE]), np.exp(world[LOG_GAIN])
        u, t = (rotation_of(world, MOUNT).T @ c_T_s[:3, 2:]).T
        row, z = pose.rotation().matrix()[2], pose.translation()[2]
        height, cosine = scale * z + row @ t, row @ u
        if jacobians is not None:
            J = np.empty((1, 6))
            J[0, :3] = cross_matrix(t - height / cosine * u) @ row / cosine
            J[0, 3:] = scale * row / cosine
            jacobians[0] = gain * J
            by_rotation = J[0, :3]
            J = np.zeros((1, WORLD_SIZE))
            J[0, MOUNT] = -gain * by_rotation @ rotation_jacobian(world, MOUNT)
            J[0, LOG_SCALE], J[0, LOG_GAIN] = gain / cosine * scale * z, gain / cosine * height
            J[0, DATUM] = 1.0
            jacobians[1] = J
        return np.array([gain * height / cosine + world[DATUM] - range_m])

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def scaled_position_factor(
    pose_key: int, world_key: int, w_p_b_m: Array, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Return a position factor: A (s p + R t) + (0, 0, f) - measured, t the body in the camera."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, world = values.atPose3(pose_key), values.atVector(world_key)
        R, p, scale = pose.rotation().matrix(), pose.translation(), np.exp(world[LOG_SCALE])
        A, t = rotation_of(world, SLOPE), rotation_of(world, MOUNT).T @ c_T_b[:3, 3]
        over_floor = scale * p + R @ t
        if jacobians is not None:
            t_hat = cross_matrix(t)
            jacobians[0] = A @ np.hstack([-R @ t_hat, scale * R])
            J = np.zeros((3, WORLD_SIZE))
            J[:, LOG_SCALE], J[2, FLOOR_Z] = scale * A @ p, 1.0
            J[:, SLOPE] = -A @ cross_matrix(over_floor) @ rotation_jacobian(world, SLOPE)
            J[:, MOUNT] = A @ R @ t_hat @ rotation_jacobian(world, MOUNT)
            jacobians[1] = J
        return np.asarray(A @ over_floor + np.array([0.0, 0.0, world[FLOOR_Z]]) - w_p_b_m)

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def level_factor(
    pose_key: int, world_key: int, c_up: Array, model: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Return the factor of the measured up direction in camera axes: (2,) rad across it, of M R' A' e_z.

    The pose is relative to the sloped floor, but gravity is that of the world. Source: derived.
    """
    across = np.linalg.svd(c_up[None])[2][1:]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        R, world = values.atPose3(pose_key).rotation().matrix(), values.atVector(world_key)
        f_up = rotation_of(world, SLOPE)[2]
        up, seen = R.T @ f_up, across @ rotation_of(world, MOUNT)
        if jacobians is not None:
            jacobians[0] = seen @ np.hstack([cross_matrix(up), np.zeros((3, 3))])
            J = np.zeros((2, WORLD_SIZE))
            J[:, SLOPE] = seen @ R.T @ cross_matrix(f_up) @ rotation_jacobian(world, SLOPE)
            J[:, MOUNT] = -seen @ cross_matrix(up) @ rotation_jacobian(world, MOUNT)
            jacobians[1] = J
        return np.asarray(seen @ up)

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def body_up(roll_pitch_yaw_rad: Array) -> Array:
    """Return the world's up direction (3,) in body axes, for R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, _ = roll_pitch_yaw_rad
    return np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
