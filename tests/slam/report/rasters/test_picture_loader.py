"""Pictures of a mosaic, as if all rows had been exposed at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from frontend.rolling_shutter import picture_at_once
from slam.core.streams import Frames
from slam.report.rasters.picture_loader import PictureLoader
from tests.slam.evaluation.scene import estimate_of

CAMERA = Camera((80.0, 80.0), (49.5, 39.5), (100, 80))
MOVED_M, TURNED_RAD = np.array([0.4, 0.1, 0.0]), np.array([0.02, 0.0, 0.03])


def loaders() -> tuple[PictureLoader, PictureLoader, np.ndarray]:
    """Of a rolling and of a global shutter, and the pictures."""
    pictures = np.random.default_rng(0).integers(0, 255, (3, 80, 100, 3), dtype=np.uint8)
    frames = Frames(np.arange(3.0), ("a", "b", "c"), lambda k: pictures[k])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 2, 3] = 10.0
    still = replace(estimate_of(poses), camera=CAMERA, frame_index=np.array([2, 1, 0]))
    moved_m = np.array([MOVED_M, np.full(3, np.nan), 2 * MOVED_M])
    moving = replace(still, row_motion_m=moved_m, row_turn_rad=np.tile(TURNED_RAD, (3, 1)))
    return *(PictureLoader.of(each, frames, CAMERA) for each in (moving, still)), pictures


def test_rows_are_put_back_where_the_motion_is_known():
    moving, still, pictures = loaders()
    for k, moved_m in ((0, MOVED_M), (2, 2 * MOVED_M)):
        put_back = picture_at_once(
            pictures[2 - k], CAMERA, moving.over_floor_T_b[k], 0.0, moved_m, TURNED_RAD
        )
        np.testing.assert_array_equal(moving(k), put_back)
        assert not np.array_equal(put_back, pictures[2 - k])
    np.testing.assert_array_equal(moving(1), pictures[1])
    for k in range(3):
        np.testing.assert_array_equal(still(k), pictures[2 - k])


def test_damaged_pictures_stay_as_they_are():
    moving, _, pictures = loaders()
    lost = replace(moving, frames=replace(moving.frames, load=lambda k: None))
    cut = replace(moving, frames=replace(moving.frames, load=lambda k: pictures[k][:40]))
    assert lost(0) is None
    np.testing.assert_array_equal(cut(0), pictures[2][:40])
