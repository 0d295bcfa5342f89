"""Factors that gtsam lacks: measurements in metres of poses that are kept in units of the mean height.

The scale variable holds (log s, floor height f, log g): a camera pose (R, p) stands in the world at
s p + (0, 0, f), and the ranging sensor reads g times the range.
gtsam crashes on a custom factor that returns no or ill-shaped Jacobians; these always return them.
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scaled_range_factor(
    pose_key: int, scale_key: int, range_m: float, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Slant range along the body's -z axis to the floor: g s z / R33 - range.

    With ``r`` the third row of R, ``u`` the body's z axis and ``t`` the body's origin in camera axes: the
    body's z is s p_z + r t and R33 = r u; a right perturbation w turns r into r - w x r. Source: derived.
    """
    u, t = c_T_b[:3, 2], c_T_b[:3, 3]

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, (log_scale, _, log_gain) = values.atPose3(pose_key), values.atPoint3(scale_key)
        scale, gain = np.exp(log_scale), np.exp(log_gain)
        row, z = pose.rotation().matrix()[2], pose.translation()[2]
        height, cosine = scale * z + row @ t, row @ u
        if jacobians is not None:
            J = np.empty((1, 6))
            J[0, :3] = (np.cross(t, row) - height / cosine * np.cross(u, row)) / cosine
            J[0, 3:] = scale * row / cosine
            jacobians[0] = gain * J
            jacobians[1] = gain / cosine * np.array([[scale * z, 0.0, height]])
        return np.array([gain * height / cosine - range_m])

    return gtsam.CustomFactor(model, [pose_key, scale_key], error)


def scaled_position_factor(
    pose_key: int, scale_key: int, w_p_b_m: Array, model: gtsam.noiseModel.Base, c_T_b: Array
) -> gtsam.CustomFactor:
    """Position of the body's origin: s p + R t + (0, 0, f) - measured."""
    t = c_T_b[:3, 3]
    t_hat = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, (log_scale, floor_z, _) = values.atPose3(pose_key), values.atPoint3(scale_key)
        R, p, scale = pose.rotation().matrix(), pose.translation(), np.exp(log_scale)
        if jacobians is not None:
            jacobians[0] = np.hstack([-R @ t_hat, scale * R])
            jacobians[1] = np.column_stack([scale * p, [0.0, 0.0, 1.0], np.zeros(3)])
        return scale * p + R @ t + np.array([0.0, 0.0, floor_z]) - w_p_b_m

    return gtsam.CustomFactor(model, [pose_key, scale_key], error)


def body_up(roll_pitch_yaw_rad: Array) -> Array:
    """(3,) the world's up direction in body axes, for R_wb = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, _ = roll_pitch_yaw_rad
    return np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
