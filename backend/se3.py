"""Rigid transforms as stacks of (n, 4, 4) matrices, with the few operations that the back end needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

Array = NDArray[np.float64]

PLANAR = np.array([3, 4, 2])
"""Indices of gtsam's planar tangent (x, y, heading) in the spatial one (rotation, translation)."""


def inverse(T: Array) -> Array:
    """Invert rigid transforms. (..., 4, 4) -> (..., 4, 4)."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1
    return out


def log(T: Array) -> Array:
    """Return tangent vectors (rotation, translation) of finite transforms. (n, 4, 4) -> (n, 6), rad and m.

    Source: Barfoot 2017, State Estimation for Robotics, section 7.1.
    """
    R, t = T[:, :3, :3], T[:, :3, 3]
    twice = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.sqrt((twice * twice).sum(axis=1)) / 2
    angle = np.arctan2(sine, (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1) / 2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    ratio = np.where(small, 0.5 + angle**2 / 12, safe / np.where(small, 2.0, 2 * np.maximum(sine, 1e-300)))
    w = ratio[:, None] * twice
    half_turn = angle > 3.1
    if half_turn.any():
        # The skew part vanishes at half a turn: there the symmetric part gives the axis.
        w[half_turn] = Rotation.from_matrix(R[half_turn]).as_rotvec()
    curve = np.where(small, 1 / 12 + angle**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    across = np.cross(w, t)
    v = t - across / 2 + curve[:, None] * np.cross(w, across)
    return np.hstack([w, v])


def exp(xi: Array) -> Array:
    """Return the transforms of tangent vectors (rotation, translation). (n, 6) -> (n, 4, 4)."""
    return RigidTransform.from_exp_coords(xi).as_matrix() if len(xi) else np.zeros((0, 4, 4))


def adjoint(T: Array) -> Array:
    """Return the adjoint, ``T Exp(xi) T^-1 = Exp(adjoint(T) xi)``. (..., 4, 4) -> (..., 6, 6)."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., 3:, :3] = cross_matrix(t) @ R
    return out


def cross_matrix(v: Array) -> Array:
    """Return the matrix with ``cross_matrix(v) @ u == cross(v, u)``. (..., 3) -> (..., 3, 3)."""
    if v.ndim == 1:  # a third of the time, which counts in factors
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def from_planar(xyt: Array) -> Array:
    """Embed planar poses (x, y, heading) in space. (n, 3) -> (n, 4, 4)."""
    T = np.tile(np.eye(4), (len(xyt), 1, 1))
    c, s = np.cos(xyt[:, 2]), np.sin(xyt[:, 2])
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, :2, 3] = xyt[:, :2]
    return T


def to_planar(T: Array) -> Array:
    """Return (x, y, heading) of transforms that lie in the plane. (n, 4, 4) -> (n, 3)."""
    return np.column_stack([T[:, 0, 3], T[:, 1, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])


def planar_log(T: Array) -> Array:
    """Return the tangent vectors (x, y, heading) of transforms that lie in the plane. (n, 4, 4) -> (n, 3)."""
    heading = np.arctan2(T[:, 1, 0], T[:, 0, 0])
    half = heading / 2
    small = np.abs(half) < 1e-4
    along = np.where(small, 1 - half**2 / 3, half / np.tan(np.where(small, 1.0, half)))
    x, y = T[:, 0, 3], T[:, 1, 3]
    return np.column_stack([along * x + half * y, along * y - half * x, heading])


def nearest_rotations(M: Array) -> Array:
    """Return the rotations nearest to matrices in the Frobenius norm. (n, d, d) -> (n, d, d)."""
    if M.shape[-1] == 2:
        heading = np.arctan2(M[:, 1, 0] - M[:, 0, 1], M[:, 0, 0] + M[:, 1, 1])
        c, s = np.cos(heading), np.sin(heading)
        return np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2)
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    return np.asarray(U @ Vt)


def orthonormal(T: Array) -> Array:
    """Make the rotations of transforms orthonormal again after rounding; NaN stays NaN."""
    R = T[:, :3, :3]
    with np.errstate(invalid="ignore"):
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2)) > 1e-9
    mended = T.copy()
    mended[off, :3, :3] = nearest_rotations(R[off])
    return mended
