"""The pictures of a map as its mosaic draws them: as if all rows had been exposed at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.rolling_shutter import NO_TURN, picture_at_once
from slam.core.estimate import Estimate
from slam.core.streams import Frames, Image

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PictureLoader:
    """Loads the picture of a pose."""

    frames: Frames
    camera: Camera
    frame_index: NDArray[np.int64]
    """(n,) frame of each pose."""
    over_floor_T_b: Array
    """(n, 4, 4)."""
    floor_z_m: float
    row_motion_m: Array | None
    row_turn_rad: Array | None
    """Both as in `Estimate`."""

    @staticmethod
    def of(estimate: Estimate, frames: Frames, camera: Camera) -> PictureLoader:
        """Return the loader of the keyframes of an estimate."""
        return PictureLoader(
            frames,
            camera,
            estimate.frame_index,
            estimate.over_floor_T_b,
            estimate.floor_z_m,
            estimate.row_motion_m,
            estimate.row_turn_rad,
        )

    def __call__(self, k: int) -> Image | None:
        """Return the picture of pose k; None where it is damaged or missing."""
        picture = self.frames[int(self.frame_index[k])].read()
        if picture is None or self.row_motion_m is None or picture.shape[1::-1] != self.camera.size_px:
            return picture
        moved_m, pose = self.row_motion_m[k], self.over_floor_T_b[k]
        turned_rad = NO_TURN if self.row_turn_rad is None else self.row_turn_rad[k]
        if not (np.isfinite(moved_m).all() and np.isfinite(pose).all()):
            return picture
        return picture_at_once(picture, self.camera, pose, self.floor_z_m, moved_m, turned_rad)
