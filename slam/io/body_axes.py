"""Conversions between the axes of aviation and those of a flight.

Autopilots use the frame ``n``, north-east-down, and body axes ``frd``, forward-right-down. A flight has the
world ``w``, east-north-up, and the body ``b``, forward-left-up. Heading h, clockwise from north, becomes the
yaw 90 degrees - h; roll keeps its sign; pitch, positive nose up, becomes positive nose down.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.rotations import roll_pitch_yaw_of, rotation_of

Array = NDArray[np.float64]

W_R_N: Array = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""Rotation from north-east-down to east-north-up."""
FRD_R_B: Array = np.diag([1.0, -1, -1])
"""Rotation from forward-left-up to forward-right-down; it is its own inverse."""
MIN_QUATERNION = 1e-6
"""A shorter quaternion was never written, and has no direction."""


def body_from_frd(frd_v: Array) -> Array:
    """Return vectors (n, 3) of forward-right-down axes in forward-left-up axes."""
    return np.asarray(frd_v, dtype=float) * np.diag(FRD_R_B)


def angles_from_aviation(roll_pitch_heading_rad: Array) -> Array:
    """Return roll, pitch, yaw (n, 3) of a flight from an autopilot's roll, pitch, heading in radians.

    Rows that lack an angle are NaN.
    """
    known = np.asarray(np.isfinite(roll_pitch_heading_rad).all(axis=1))
    n_R_frd = rotation_of(np.where(known[:, None], roll_pitch_heading_rad, 0.0))
    return _with_missing(W_R_N @ n_R_frd @ FRD_R_B, known)


def angles_from_ned_quaternion(n_q_frd: Array) -> Array:
    """Return roll, pitch, yaw (n, 3) in radians from quaternions (n, 4), w first, of frd axes in ``n``.

    Rows without a quaternion are NaN.
    """
    rotation, known = _rotations(n_q_frd)
    return _with_missing(W_R_N @ rotation @ FRD_R_B, known)


def angles_from_quaternion(w_q_b: Array) -> Array:
    """Return roll, pitch, yaw (n, 3) in radians from quaternions (n, 4), w first, of the body in the world.

    Rows without a quaternion are NaN.
    """
    return _with_missing(*_rotations(w_q_b))


def _rotations(q: Array) -> tuple[Array, NDArray[np.bool_]]:
    q = np.asarray(q, dtype=float)
    length = np.linalg.norm(q, axis=1)
    known = np.isfinite(length) & (length > MIN_QUATERNION)
    identity = np.array([1.0, 0, 0, 0])
    return Rotation.from_quat(np.where(known[:, None], q, identity), scalar_first=True).as_matrix(), known


def _with_missing(w_R_b: Array, known: NDArray[np.bool_]) -> Array:
    return np.where(known[:, None], roll_pitch_yaw_of(w_R_b), np.nan)
