"""Roll, pitch and yaw, and what they turn: ``R_wb = Rz(yaw) Ry(pitch) Rx(roll)``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.flight import AttitudeSeries

Array = NDArray[np.float64]


def rotation_of(roll_pitch_yaw_rad: Array) -> Array:
    """(..., 3, 3) body to world, of angles (..., 3)."""
    angles = np.asarray(roll_pitch_yaw_rad, dtype=float)
    turned = Rotation.from_euler("ZYX", angles.reshape(-1, 3)[:, ::-1])
    return np.asarray(turned.as_matrix(), dtype=float).reshape(*angles.shape, 3)


def roll_pitch_yaw_of(w_R_b: Array) -> Array:
    """(..., 3) radians of rotations (..., 3, 3); roll and yaw in -pi..pi, pitch in -pi/2..pi/2."""
    angles = Rotation.from_matrix(w_R_b.reshape(-1, 3, 3)).as_euler("ZYX")
    return np.asarray(angles[:, ::-1], dtype=float).reshape(w_R_b.shape[:-1])


def up_at(attitude: AttitudeSeries | None, at_s: Array) -> Array:
    """(n, 3) the world's up in body axes at some times (n,); of a level body where no attitude is known."""
    roll_pitch_yaw = np.zeros((len(at_s), 3))
    if attitude is not None:
        known = np.isfinite(attitude.roll_pitch_yaw_rad[:, :2]).all(axis=1)
        if known.any():
            angles = np.unwrap(attitude.roll_pitch_yaw_rad[known, :2], axis=0)
            for axis in (0, 1):
                roll_pitch_yaw[:, axis] = np.interp(at_s, attitude.stamps_s[known], angles[:, axis])
    return rotation_of(roll_pitch_yaw)[:, 2]
