"""Conversions between roll, pitch, yaw and rotations: ``R_wb = Rz(yaw) Ry(pitch) Rx(roll)``."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.streams import AttitudeSeries

Array = NDArray[np.float64]


def rotation_of(roll_pitch_yaw_rad: Array) -> Array:
    """Return rotations (..., 3, 3) from body to world for angles (..., 3) in radians."""
    angles = np.asarray(roll_pitch_yaw_rad, dtype=float)
    # Written out: SciPy composes three quaternions, which takes twenty times as long for a whole stream.
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rotations = np.empty((*angles.shape, 3))
    rotations[..., 0, 0], rotations[..., 0, 1], rotations[..., 0, 2] = (
        cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,
    )  # fmt: skip
    rotations[..., 1, 0], rotations[..., 1, 1], rotations[..., 1, 2] = (
        sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,
    )  # fmt: skip
    rotations[..., 2, 0], rotations[..., 2, 1], rotations[..., 2, 2] = -sp, cp * sr, cp * cr
    return rotations


def roll_pitch_yaw_of(w_R_b: Array) -> Array:
    """Return angles (..., 3) in radians of rotations (..., 3, 3).

    Roll and yaw lie in -pi..pi, pitch in -pi/2..pi/2.
    """
    with warnings.catch_warnings():
        # At a pitch of 90 degrees any roll belongs to some yaw; SciPy chooses one and warns.
        warnings.filterwarnings("ignore", "Gimbal lock", UserWarning)
        angles = Rotation.from_matrix(w_R_b.reshape(-1, 3, 3)).as_euler("ZYX")
    return np.asarray(angles[:, ::-1], dtype=float).reshape(w_R_b.shape[:-1])


def up_at(attitude: AttitudeSeries | None, at_s: Array) -> Array:
    """Return (n, 3) the world's up in body axes at times (n,); the body is assumed level where unknown."""
    roll_pitch_yaw = np.zeros((len(at_s), 3))
    if attitude is not None:
        known = np.isfinite(attitude.roll_pitch_yaw_rad[:, :2]).all(axis=1)
        if known.any():
            angles = np.unwrap(attitude.roll_pitch_yaw_rad[known, :2], axis=0)
            for axis in (0, 1):
                roll_pitch_yaw[:, axis] = np.interp(at_s, attitude.stamps_s[known], angles[:, axis])
    return rotation_of(roll_pitch_yaw)[:, 2]
