"""Obstacle masking: no features are extracted from pixels that show obstacles above the floor.

Source: IMAV 2011 paper, section 3.1.1: the piece of the elevation map under picture i is extracted with the
inverse of H_i0, and pixels above gamma_3 are masked.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.elevation import Elevation
from frontend.features import Features

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

STEP_PX = 4
"""Pixel spacing at which the mask is computed."""
LEVELS = 5
"""Number of heights at which obstacles are looked up: foot and top project to different pixels."""


class ObstacleMask:
    """Masks for the pictures of one camera over one elevation map."""

    def __init__(self, elevation: Elevation, camera: Camera, floor_z_m: float, gamma_3_m: float) -> None:
        """``gamma_3_m``: ground higher than this is masked."""
        self.elevation, self.camera, self.floor_z_m, self.gamma_3_m = elevation, camera, floor_z_m, gamma_3_m
        w, h = camera.size_px
        u, v = np.meshgrid(np.arange(STEP_PX // 2, w, STEP_PX), np.arange(STEP_PX // 2, h, STEP_PX))
        self._shape = u.shape
        self._pixel = camera.undistort(np.column_stack([u.ravel(), v.ravel()]).astype(float))
        highest = float(np.nanmax(elevation.height_m, initial=0.0))
        self._levels = np.linspace(0.0, highest, LEVELS)
        self._half_step = 0.5 * highest / (LEVELS - 1)

    def __call__(self, w_T_b: Array) -> Image | None:
        """Return the mask (h, w) for a pose (4, 4): 0 on obstacles, else 255; None without obstacles."""
        if not np.isfinite(w_T_b).all():
            return None
        high = np.zeros(len(self._pixel), dtype=bool)
        for level in self._levels:
            x, y = self.camera.floor_points(w_T_b, self._pixel, self.floor_z_m + level).T
            with np.errstate(invalid="ignore"):
                high |= self.elevation.at(x, y) > max(self.gamma_3_m, float(level) - self._half_step)
        if not high.any():
            return None
        # One step wider: edges are known to a cell, and features have a support region.
        wide = cv2.dilate(high.reshape(self._shape).astype(np.uint8), np.ones((3, 3), np.uint8))
        return np.asarray(cv2.resize(255 * (1 - wide), self.camera.size_px, interpolation=cv2.INTER_NEAREST))


def unless_hidden(features: Features | None, mask: Image | None, camera: Camera) -> Features | None:
    """Return the features of a whole picture, None if its mask (h, w) hides any of them.

    A mask that hides no feature changes none: the others are still the strongest.
    """
    return None if features is None or hides(mask, features.pixel, camera).any() else features


def hides(mask: Image | None, pixel: Array, camera: Camera) -> NDArray[np.bool_]:
    """Return (n,) whether a mask of a recorded picture hides each of some undistorted pixels (n, 2)."""
    if mask is None:
        return np.zeros(len(pixel), dtype=bool)
    recorded = camera.recorded(pixel)
    w, h = camera.size_px
    column, row = np.clip(np.rint(recorded), 0, [w - 1, h - 1]).astype(int).T
    return np.asarray(mask[row, column] == 0)
