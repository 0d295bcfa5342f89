"""Factors that gtsam lacks: measurements in metres of poses that are kept over their own floor.

The pictures' world has the floor at z = 0 and the mean height for its unit. One variable of five numbers
stands it in the measured world: (log s, f, log g, a, b). A camera pose (R, p) is there at s A p + (0, 0, f),
turned by A = Exp(a, b, 0), the slope of the floor; and the ranging sensor reads g times the range.

gtsam crashes on a custom factor that returns no or ill-shaped Jacobians; these always return them.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.se3 import cross_matrix

Array = NDArray[np.float64]


def scaled_range_factor(
    pose_key: int, world_key: int, range_m: float, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Slant range along the body's -z axis to the floor: g s z / R33 - range.

    With ``r`` the third row of R, ``u`` the body's z axis and ``t`` the body's origin in camera axes: the
    body's z is s p_z + r t and R33 = r u; a right perturbation w turns r into r - w x r. Source: derived.
    """
    u, t = c_T_b[:3, 2], c_T_b[:3, 3]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, (log_scale, _, log_gain, _, _) = values.atPose3(pose_key), values.atVector(world_key)
        scale, gain = np.exp(log_scale), np.exp(log_gain)
        row, z = pose.rotation().matrix()[2], pose.translation()[2]
        height, cosine = scale * z + row @ t, row @ u
        if jacobians is not None:
            J = np.empty((1, 6))
            J[0, :3] = (np.cross(t, row) - height / cosine * np.cross(u, row)) / cosine
            J[0, 3:] = scale * row / cosine
            jacobians[0] = gain * J
            jacobians[1] = gain / cosine * np.array([[scale * z, 0.0, height, 0.0, 0.0]])
        return np.array([gain * height / cosine - range_m])

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def scaled_position_factor(
    pose_key: int, world_key: int, w_p_b_m: Array, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Position of the body's origin: A (s p + R t) + (0, 0, f) - measured; t is the body in camera axes."""
    t = c_T_b[:3, 3]
    t_hat = cross_matrix(t)

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, world = values.atPose3(pose_key), values.atVector(world_key)
        R, p, scale = pose.rotation().matrix(), pose.translation(), np.exp(world[0])
        slope = np.array([world[3], world[4], 0.0])
        A, over_floor = gtsam.Rot3.Expmap(slope).matrix(), scale * p + R @ t
        if jacobians is not None:
            jacobians[0] = A @ np.hstack([-R @ t_hat, scale * R])
            J = np.zeros((3, 5))
            J[:, 0], J[2, 1] = scale * A @ p, 1.0
            J[:, 3:] = (-A @ cross_matrix(over_floor) @ gtsam.Rot3.ExpmapDerivative(slope))[:, :2]
            jacobians[1] = J
        return A @ over_floor + np.array([0.0, 0.0, world[1]]) - w_p_b_m

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def level_factor(
    pose_key: int, world_key: int, c_up: Array, model: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Measured up direction in camera axes against the world's, R' A' e_z: (2,) rad across the measured one.

    The pose stands over its own floor, but gravity is the world's. Source: derived.
    """
    across = np.linalg.svd(c_up[None])[2][1:]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        R = values.atPose3(pose_key).rotation().matrix()
        slope = np.array([*values.atVector(world_key)[3:], 0.0])
        f_up = gtsam.Rot3.Expmap(slope).matrix()[2]
        up = R.T @ f_up
        if jacobians is not None:
            jacobians[0] = across @ np.hstack([cross_matrix(up), np.zeros((3, 3))])
            turn = gtsam.Rot3.ExpmapDerivative(slope)[:, :2]
            jacobians[1] = across @ np.hstack([np.zeros((3, 3)), R.T @ cross_matrix(f_up) @ turn])
        return np.asarray(across @ up)

    return gtsam.CustomFactor(model, [pose_key, world_key], error)


def body_up(roll_pitch_yaw_rad: Array) -> Array:
    """(3,) the world's up direction in body axes, for R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, _ = roll_pitch_yaw_rad
    return np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
