"""Rectification of pictures to those of an ideal pinhole camera.

Lens distortion changes the shape of a floor feature with its position in the picture. The position that a
detector finds then has a systematic radial error of up to a tenth of a pixel. Features of rectified pictures
do not have this error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera, Intrinsics

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_MARGIN_RATIO = 0.5
"""Margin of ideal pixels on each side, as a ratio to the size of the picture."""
_ROUND_TRIP_PX = 0.05
"""Largest error of distortion followed by undistortion. Pixels with a larger error are marked invalid."""
_LIMIT_PX = 1e6
_COARSE_STEP = 8
"""Spacing in pixels, in x and y, at which the round trip is checked."""


@dataclass(frozen=True)
class Rectifier:
    """Map from the pixels of a rectified picture (h, w) to the recorded picture."""

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    """(h, w) coordinates in the recorded picture."""
    valid: Image
    """(h, w) mask, 0 where nothing was recorded."""
    first_px: Array
    """(2,) ideal pixel coordinates of the first pixel, at the scale of the recorded picture."""

    def picture(self, recorded: Image) -> Image:
        """Return the rectified picture. The recorded one is mirrored at its border, which avoids an edge."""
        rectified = cv2.remap(recorded, self.x, self.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(rectified, dtype=np.uint8)

    def mask(self, recorded: Image | None) -> Image:
        """Return the rectified mask: 0 where nothing was recorded or where the mask ``recorded`` is 0."""
        if recorded is None:
            return self.valid
        mask = cv2.remap(recorded, self.x, self.y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT_101)
        return np.minimum(np.asarray(mask, dtype=np.uint8), self.valid)


def rectifier(camera: Camera, size_px: tuple[int, int]) -> Rectifier | None:
    """Return the rectifier for pictures scaled to ``size_px`` (width, height); None without distortion."""
    if not camera.is_distorted:
        return None
    return _rectifier(camera.intrinsics, size_px)


@lru_cache(maxsize=4)
def _rectifier(intrinsics: Intrinsics, size_px: tuple[int, int]) -> Rectifier:
    camera, full_px = intrinsics.camera(), intrinsics.size_px
    scale = np.array(full_px) / np.array(size_px)
    first = -np.ceil(_MARGIN_RATIO * np.array(size_px))
    count = np.ceil((np.array(size_px) - 2 * first) / _COARSE_STEP).astype(int)
    ideal = first + _COARSE_STEP * np.stack(np.meshgrid(*map(np.arange, count)), axis=-1)
    recorded = _to_recorded(camera, scale, first, _COARSE_STEP, count)
    back = camera.undistort(recorded.reshape(-1, 2)).reshape(ideal.shape)
    invertible = np.linalg.norm(back - ((ideal + 0.5) * scale - 0.5), axis=2) < _ROUND_TRIP_PX
    # A pixel between checked ones may be valid if any checked neighbour is.
    near = cv2.dilate((invertible & _inside(recorded, full_px)).astype(np.uint8), np.ones((3, 3), np.uint8))
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    if len(rows) == 0:
        empty = np.zeros((1, 1), np.float32)
        return Rectifier(empty, empty, np.zeros((1, 1), np.uint8), np.zeros(2))
    low, last = (np.array([columns[k], rows[k]]) for k in (0, -1))
    recorded = _to_recorded(camera, scale, first + _COARSE_STEP * low, 1, _COARSE_STEP * (last - low + 1))
    invertible_px = invertible[low[1] : last[1] + 1, low[0] : last[0] + 1]
    invertible_px = invertible_px.repeat(_COARSE_STEP, axis=0).repeat(_COARSE_STEP, axis=1)
    valid = (255 * (_inside(recorded, full_px) & invertible_px)).astype(np.uint8)
    at = ((recorded + 0.5) / scale - 0.5).astype(np.float32)
    return Rectifier(at[..., 0], at[..., 1], valid, first + _COARSE_STEP * low)


def _to_recorded(camera: Camera, scale: Array, first: Array, step: int, count: NDArray[np.int64]) -> Array:
    """Return (h, w, 2) recorded pixels of a grid of ideal pixels.

    The grid takes every ``step``-th pixel from ``first`` on, ``count`` (w, h) of them, of a picture ``scale``
    times smaller than the recorded one.
    """
    focal = np.array(camera.focal_px) / scale / step
    center = ((np.array(camera.center_px) + 0.5) / scale - 0.5 - first) / step
    matrix = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    maps = camera.recorded_maps(matrix, (int(count[0]), int(count[1])))
    # Values far outside the picture are clipped to keep them finite; they are marked invalid.
    return np.asarray(np.clip(np.nan_to_num(np.stack(maps, axis=-1), nan=-_LIMIT_PX), -_LIMIT_PX, _LIMIT_PX))


def _inside(recorded: Array, size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (h, w) whether recorded pixels (h, w, 2) lie in the picture."""
    inside = ((recorded >= -0.5) & (recorded <= np.array(size_px) - 0.5)).all(axis=-1)
    return np.asarray(inside)
