"""Transfer of pixels between two pictures over the floor, for a camera that may differ from the nominal one.

The chain is pixel j, ray, floor point, pixel in picture i. Vectors are in metres; poses (m, 6) are x, y, z,
roll, pitch and yaw of the vehicle in the world. Warps are errors that no camera term of the catalogue
describes. Without them an unmodelled lens error passes for a term: stretched columns for a tilted camera.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.core.arrays import Array
from slam.core.rotations import rotation_of
from slam.criticism.kalman.filter_parameters import FOCAL, RADIAL, TILT_X, TILT_Y

NUDGE = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-4])
"""Finite-difference step of each entry of the camera's vector that moves points."""
LENS_MAP_PATTERN = "picture bent from place to place"
"""The last warp: the map of ``lens_distortion_map``, with its root mean square in px as the unit."""
_KINDS = (
    ("picture columns stretched against rows", 3e-3),
    ("picture sheared", 3e-3),
    ("picture turned", 1e-3),
    ("picture stretched ~ time", 3e-3),
    ("picture turned ~ time", 1e-3),
    ("picture shifted ~ time: columns", 1e-3),
    ("picture shifted ~ time: rows", 1e-3),
    (LENS_MAP_PATTERN, 0.03),
)
WARPS = tuple(name for name, _ in _KINDS)
WARP_TOLERANCE = np.array([std for _, std in _KINDS])
"""Largest apparent error of a healthy camera from features on small pictures, as for the camera's own terms.
"""
PAIRS = (("picture shifted ~ time: columns", "picture shifted ~ time: rows"),)
"""Pairs that are one warp, along columns and along rows."""


def floor_of(nominal: Camera, camera: Array, pose: Array, pixel: Array, slope: Array) -> Array:
    """Return (m, 3) the points that pixels (m, 2) show from poses (m, 6), on a floor z = slope . (x, y)."""
    focal = np.array(nominal.focal_px) * (1.0 + camera[FOCAL])
    seen = (pixel - nominal.center_px) / focal
    plain = seen
    for _ in range(4):
        plain = seen / (1.0 + camera[RADIAL] * (plain**2).sum(axis=1, keepdims=True))
    w_R_c, w_t_c = _placed(nominal, camera, pose)
    ray = np.einsum("mij,mj->mi", w_R_c, np.column_stack([plain, np.ones(len(plain))]))
    above = w_t_c[:, 2] - w_t_c[:, :2] @ slope
    reach = above / (ray[:, :2] @ slope - ray[:, 2])
    return np.asarray(w_t_c + reach[:, None] * ray)


def pixels_of(nominal: Camera, camera: Array, pose: Array, point: Array) -> Array:
    """Return (m, 2) the projections in px of world points (m, 3) from poses (m, 6)."""
    w_R_c, w_t_c = _placed(nominal, camera, pose)
    c_p = np.einsum("mji,mj->mi", w_R_c, point - w_t_c)
    plain = c_p[:, :2] / c_p[:, 2:]
    seen = plain * (1.0 + camera[RADIAL] * (plain**2).sum(axis=1, keepdims=True))
    return np.asarray(seen * np.array(nominal.focal_px) * (1.0 + camera[FOCAL]) + nominal.center_px)


def _placed(nominal: Camera, camera: Array, pose: Array) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and positions (m, 3) of the cameras of vehicles with poses (m, 6)."""
    turned = Rotation.from_rotvec([camera[TILT_X], camera[TILT_Y], 0.0]).as_matrix()
    w_R_b = rotation_of(pose[:, 3:])
    w_R_c = w_R_b @ (turned @ nominal.b_T_c[:3, :3])
    return w_R_c, pose[:, :3] + w_R_b @ (turned @ nominal.b_T_c[:3, 3])


def warp(camera: Camera, pixel: Array, elapsed: Array) -> Array:
    """Return (m, 2, warps except ``LENS_MAP_PATTERN``) displacements in px of points (m, 2) by a unit each.

    Units are tangents of angles. ``elapsed`` (m,) is the elapsed share of the flight minus one half. Stretch
    and shear change neither the size nor the rotation of a picture, so they correlate least with the focal
    length. An offset of the principal point is not among the warps: it resembles a tilted camera too much,
    and takes a quarter of such a tilt.
    """
    x, y = ((pixel - camera.center_px) / camera.focal_px).T
    none = np.zeros(len(x))
    along = (
        (x / 2, -y / 2), (y / 2, x / 2), (-y, x),
        (elapsed * x, elapsed * y), (-elapsed * y, elapsed * x), (elapsed, none), (none, elapsed),
    )  # fmt: skip
    off = np.stack([np.stack(both, axis=-1) for both in along], axis=-1)
    return np.asarray(off * np.array(camera.focal_px)[:, None])
