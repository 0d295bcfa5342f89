"""Pictures whose rows were exposed one after the other, rendered row by row, as if exposed at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from frontend.rolling_shutter import NO_TURN, picture_at_once

CAMERA = Camera((260.0, 262.0), (159.5, 121.0), (320, 240))
BENT = replace(CAMERA, distortion=(-0.1, 0.02, 0.001, -0.001))
FLOOR_Z_M = 2.0
MOVED_M = np.array([0.6, -0.2, 0.05])
"""Forward, left and up, at 50 m: three pixels."""
TURNED_RAD = np.array([0.01, -0.02, 0.015])


def over_floor(tilt_rad: float) -> np.ndarray:
    w_T_b = np.eye(4)
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    w_T_b[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    w_T_b[:3, 3] = [3.0, -4.0, FLOOR_Z_M + 50.0]
    return w_T_b


def grey(floor: np.ndarray) -> np.ndarray:
    """Smooth waves of a few metres."""
    x, y = floor.T
    return 128 + 50 * np.sin(1.1 * x + 0.4 * y) + 50 * np.cos(0.9 * y - 0.3 * x)


def rendered(
    camera: Camera, w_T_b: np.ndarray, moved_m: np.ndarray, turned_rad: np.ndarray = NO_TURN
) -> np.ndarray:
    """Each row by the camera at the moment of its exposure."""
    w, h = camera.size_px
    picture = np.empty((h, w))
    for row in range(h):
        pose = w_T_b.copy()
        pose[:3, 3] += w_T_b[:3, :3] @ moved_m * (row / (h - 1) - 0.5)
        turn = Rotation.from_rotvec(turned_rad * (row / (h - 1) - 0.5)).as_matrix()
        pose[:3, :3] = w_T_b[:3, :3] @ turn
        pixel = np.column_stack([np.arange(w), np.full(w, row)]).astype(float)
        picture[row] = grey(camera.floor_points(pose, camera.undistort(pixel), FLOOR_Z_M))
    return np.round(picture).astype(np.uint8)


@pytest.mark.parametrize(
    ("camera", "tilt_rad", "turned_rad"),
    [
        (CAMERA, 0.0, NO_TURN), (CAMERA, 0.3, NO_TURN), (BENT, 0.0, NO_TURN), (BENT, 0.3, NO_TURN),
        (BENT, 0.1, TURNED_RAD),
    ],
)  # fmt: skip
def test_rows_are_put_back(camera: Camera, tilt_rad: float, turned_rad: np.ndarray):
    pose = over_floor(tilt_rad)
    once, rolling = rendered(camera, pose, 0 * MOVED_M), rendered(camera, pose, MOVED_M, turned_rad)
    found = picture_at_once(rolling, camera, pose, FLOOR_Z_M, MOVED_M, turned_rad)
    off, before = (np.abs(each.astype(float) - once)[8:-8, 8:-8] for each in (found, rolling))
    assert off.mean() < 0.1 * before.mean()
    assert np.percentile(off, 99) < 3


def test_a_camera_at_rest_keeps_its_picture():
    pose = over_floor(0.1)
    picture = rendered(CAMERA, pose, MOVED_M)[..., None].repeat(3, axis=2)
    np.testing.assert_array_equal(picture_at_once(picture, CAMERA, pose, FLOOR_Z_M, np.zeros(3)), picture)


def test_a_picture_with_the_horizon_stays_finite():
    pose = over_floor(1.2)
    picture = np.full((240, 320, 3), 200, np.uint8)
    np.testing.assert_array_equal(picture_at_once(picture, CAMERA, pose, FLOOR_Z_M, MOVED_M), picture)
