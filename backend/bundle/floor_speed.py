"""Velocity and turn of a camera over a plane, from how the plane moves through its picture (optical flow).

Source: Longuet-Higgins and Prazdny 1980 (motion of a picture by velocity and turn of its camera).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_SINGULAR = 1e-3
"""Least singular value that counts, over the largest: a narrow lens hardly tells a turn from a velocity, and
then either explains what the picture shows."""


def camera_motion(f_T_c: Array, xy: Array, speed: Array) -> tuple[Array, Array]:
    """Return velocities (n, 3) and angular velocities (n, 3), in rad/s, of cameras over the plane z = 0.

    ``f_T_c`` (n, 4, 4) are poses, ``speed`` (n, k, 2) are the speeds in the directions ``xy`` (k, 2) at depth
    1, per second. Both results are in the axes of f, and NaN where a speed is NaN.
    """
    ray = np.column_stack([xy, np.ones(len(xy))])
    R, place = f_T_c[:, :3, :3], f_T_c[:, :3, 3]
    inverse_depth = -np.einsum("na,ka->nk", R[:, 2], ray) / place[:, 2, None]
    is_known = np.asarray(np.isfinite(speed).all(axis=(1, 2)))
    u, v = xy.T
    to_plane = np.array([[np.ones_like(u), 0 * u, -u], [0 * u, np.ones_like(u), -v]]).transpose(2, 0, 1)
    by_velocity = -inverse_depth[:, :, None, None] * to_plane  # (n, k, 2, 3)
    both = np.concatenate([by_velocity, np.broadcast_to(_flow_by_turn(xy), by_velocity.shape)], axis=3)
    inverse = np.linalg.pinv(both.reshape(len(f_T_c), -1, 6), rcond=_LEAST_SINGULAR)
    found = np.einsum("nab,nb->na", inverse, np.nan_to_num(speed).reshape(len(f_T_c), -1))
    found = np.where(is_known[:, None], found, np.nan)
    f_v, f_turn = (np.einsum("nab,nb->na", R, part) for part in (found[:, :3], found[:, 3:]))
    return f_v, f_turn


def _flow_by_turn(xy: Array) -> Array:
    """Return the speeds (k, 2, 3) in the directions ``xy`` (k, 2) at depth 1, for each rad/s of a turn about
    the axes of the camera."""
    u, v = xy.T
    return np.array([[u * v, -(1 + u * u), v], [1 + v * v, -u * v, -u]]).transpose(2, 0, 1)
