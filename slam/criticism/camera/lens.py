"""From one picture's pixels to another's over the floor, through a camera that may differ from what is told.

Pixel j -> ray -> floor -> picture i. Every row has its own moment: the path is taken along its rates from the
moment of the middle row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.criticism.kalman.camera_parameters import FOCAL, RADIAL, TILT_X, TILT_Y

Array = NDArray[np.float64]

NUDGE = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-4])
"""Step of the differences in each entry of the camera's vector that moves points."""


def floor_of(told: Camera, camera: Array, pose: Array, pixel: Array, slope: Array) -> Array:
    """(m, 3) world points of a sloped floor z = slope . (x, y) that pixels (m, 2) show from poses (m, 6)."""
    focal = np.array(told.focal_px) * (1.0 + camera[FOCAL])
    seen = (pixel - told.center_px) / focal
    plain = seen
    for _ in range(4):
        plain = seen / (1.0 + camera[RADIAL] * (plain**2).sum(axis=1, keepdims=True))
    w_R_c, w_t_c = _placed(told, camera, pose)
    ray = np.einsum("mij,mj->mi", w_R_c, np.column_stack([plain, np.ones(len(plain))]))
    above = w_t_c[:, 2] - w_t_c[:, :2] @ slope
    reach = above / (ray[:, :2] @ slope - ray[:, 2])
    return np.asarray(w_t_c + reach[:, None] * ray)


def pixels_of(told: Camera, camera: Array, pose: Array, point: Array) -> Array:
    """(m, 2) pixels that world points (m, 3) have from poses (m, 6)."""
    w_R_c, w_t_c = _placed(told, camera, pose)
    c_p = np.einsum("mji,mj->mi", w_R_c, point - w_t_c)
    plain = c_p[:, :2] / c_p[:, 2:]
    seen = plain * (1.0 + camera[RADIAL] * (plain**2).sum(axis=1, keepdims=True))
    return np.asarray(seen * np.array(told.focal_px) * (1.0 + camera[FOCAL]) + told.center_px)


def _placed(told: Camera, camera: Array, pose: Array) -> tuple[Array, Array]:
    """(m, 3, 3) and (m, 3): where cameras are whose vehicles have poses (m, 6)."""
    turned = Rotation.from_rotvec([camera[TILT_X], camera[TILT_Y], 0.0]).as_matrix()
    w_R_b = _rotation(pose[:, 3], pose[:, 4], pose[:, 5])
    w_R_c = w_R_b @ (turned @ told.b_T_c[:3, :3])
    return w_R_c, pose[:, :3] + w_R_b @ (turned @ told.b_T_c[:3, 3])


def _rotation(roll: Array, pitch: Array, yaw: Array) -> Array:
    """(m, 3, 3) Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    return np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], axis=-1),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], axis=-1),
            np.stack([-sp, cp * sr, cp * cr], axis=-1),
        ],
        axis=-2,
    )
