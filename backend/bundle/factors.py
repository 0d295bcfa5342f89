"""Custom factors: metric measurements of poses that are in units of the mean height above the floor.

The frame of the pictures has the floor at z = 0 and the mean height as its unit. One variable of fourteen
numbers, (log s, f, log g, d, a, b, m, n, o, l), maps it to the measured world. A camera pose (R, p) has the
position s A p + (0, 0, f) there and is rotated by A = Exp(a, b, 0), the slope of the floor. The rangefinder
reads g times the range plus d, its zero offset. The mount of the camera is the nominal one rotated by
M = Exp(m, n, 0) about the camera's axes: a direction fixed to the body is rotated by M' in camera axes.
Measured positions are those of the point l of the body, three numbers, and all of them are off by o, three
numbers: they and control points may refer to different datums.

gtsam crashes on a custom factor with missing or ill-shaped Jacobians; these always return them.
"""

from __future__ import annotations

import math
from functools import lru_cache

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.se3 import cross_matrix

Array = NDArray[np.float64]

LOG_SCALE, FLOOR_Z, LOG_GAIN, DATUM, SLOPE, MOUNT = 0, 1, 2, 3, slice(4, 6), slice(6, 8)
OFFSET, ANTENNA = slice(8, 11), slice(11, 14)
"""Index of each number in the world variable."""
WORLD_SIZE = 14
WORLD = gtsam.symbol("w", 0)
"""Key of the world variable: a refinement has one."""


def rotation_of(world: Array, which: slice) -> Array:
    """Return the rotation (3, 3) of the slope or the mount of a world variable."""
    return _rotation(*world[which].tolist())[0]


def rotation_jacobian(world: Array, which: slice) -> Array:
    """Return the Jacobian (3, 2) of that rotation, as a right perturbation, by its two numbers."""
    return _rotation(*world[which].tolist())[1]


@lru_cache(maxsize=64)
def _rotation(x: float, y: float) -> tuple[Array, Array]:
    """Return a rotation vector's matrix and Jacobian, which the factors of all keyframes share."""
    vector = np.array([x, y, 0.0])
    rotation = gtsam.Rot3.Rodrigues(vector).matrix()
    jacobian = gtsam.Rot3.ExpmapDerivative(vector)[:, :2]
    rotation.flags.writeable = jacobian.flags.writeable = False
    return rotation, jacobian


def scaled_range_factor(
    pose_key: int, range_m: float, model: gtsam.noiseModel.Base, c_T_s: Array
) -> gtsam.CustomFactor:
    """Return the factor of a slant range along the sensor's -z axis to the floor: g s z / R33 + d - range.

    With ``r`` the third row of R, ``u`` the sensor's z axis and ``t`` its origin in camera axes: the
    sensor's z is s p_z + r t and R33 = r u; a right perturbation w turns r into r - w x r. Source: derived.
    """

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, world = values.atPose3(pose_key).matrix(), values.atVector(WORLD)
        scale, gain = math.exp(world[LOG_SCALE]), math.exp(world[LOG_GAIN])
        u, t = c_T_s[:3, 2:].T @ rotation_of(world, MOUNT)
        row, z = pose[2, :3], pose[2, 3]
        height, cosine = scale * z + row @ t, row @ u
        if jacobians is not None:
            J = np.empty((1, 6))
            J[0, :3] = gain / cosine * (cross_matrix(t - height / cosine * u) @ row)
            J[0, 3:] = gain / cosine * scale * row
            jacobians[0] = J
            of_world = np.zeros((1, WORLD_SIZE))
            of_world[0, MOUNT] = -J[0, :3] @ rotation_jacobian(world, MOUNT)
            of_world[0, LOG_SCALE] = gain / cosine * scale * z
            of_world[0, LOG_GAIN], of_world[0, DATUM] = gain / cosine * height, 1.0
            jacobians[1] = of_world
        return np.array([gain * height / cosine + world[DATUM] - range_m])

    return gtsam.CustomFactor(model, [pose_key, WORLD], error)


def scaled_position_factor(
    pose_key: int, w_p_antenna_m: Array, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Return a position factor: A (s p + R t) + (0, 0, f) + o - measured, t the antenna in the camera."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, world = values.atPose3(pose_key).matrix(), values.atVector(WORLD)
        R, p, scale = pose[:3, :3], pose[:3, 3], math.exp(world[LOG_SCALE])
        A, turn = rotation_of(world, SLOPE), rotation_of(world, MOUNT).T
        t = turn @ (c_T_b[:3, :3] @ world[ANTENNA] + c_T_b[:3, 3])
        over_floor = scale * p + R @ t
        if jacobians is not None:
            AR, t_cross = A @ R, cross_matrix(t)
            J = np.empty((3, 6))
            J[:, :3], J[:, 3:] = -AR @ t_cross, scale * AR
            jacobians[0] = J
            of_world = np.zeros((3, WORLD_SIZE))
            of_world[:, LOG_SCALE], of_world[2, FLOOR_Z] = scale * A @ p, 1.0
            of_world[:, SLOPE] = -A @ cross_matrix(over_floor) @ rotation_jacobian(world, SLOPE)
            of_world[:, MOUNT] = AR @ t_cross @ rotation_jacobian(world, MOUNT)
            of_world[:, OFFSET], of_world[:, ANTENNA] = np.eye(3), AR @ turn @ c_T_b[:3, :3]
            jacobians[1] = of_world
        off = A @ over_floor + world[OFFSET] - w_p_antenna_m
        off[2] += world[FLOOR_Z]
        return np.asarray(off)

    return gtsam.CustomFactor(model, [pose_key, WORLD], error)


def level_factor(pose_key: int, c_up: Array, model: gtsam.noiseModel.Base) -> gtsam.CustomFactor:
    """Return the factor of the measured up direction in camera axes: (2,) rad across it, of M R' A' e_z.

    The pose is relative to the sloped floor, but gravity is that of the world. Source: derived.
    """
    # Unit vectors across it, the first along its cross product with the axis that it is farthest from.
    first = cross_matrix(c_up)[:, np.argmin(np.abs(c_up))]
    first = first / np.linalg.norm(first)
    across = np.array([first, cross_matrix(c_up) @ first])

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        R, world = values.atPose3(pose_key).matrix()[:3, :3], values.atVector(WORLD)
        f_up = rotation_of(world, SLOPE)[2]
        up, seen = f_up @ R, across @ rotation_of(world, MOUNT)
        if jacobians is not None:
            by_up = seen @ cross_matrix(up)
            J = np.zeros((2, 6))
            J[:, :3] = by_up
            jacobians[0] = J
            of_world = np.zeros((2, WORLD_SIZE))
            of_world[:, SLOPE] = seen @ R.T @ cross_matrix(f_up) @ rotation_jacobian(world, SLOPE)
            of_world[:, MOUNT] = -by_up @ rotation_jacobian(world, MOUNT)
            jacobians[1] = of_world
        return np.asarray(seen @ up)

    return gtsam.CustomFactor(model, [pose_key, WORLD], error)


def body_up(roll_pitch_yaw_rad: Array) -> Array:
    """Return the world's up direction (3,) in body axes, for R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, _ = roll_pitch_yaw_rad
    return np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
