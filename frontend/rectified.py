"""Pictures as an ideal pinhole would have taken them.

A lens that draws the border together shows one spot of the floor in other shapes from other places. What a
detector takes for the middle of a spot then moves with the shape, outwards or inwards, by up to a tenth of a
pixel and always the same way. Features of rectified pictures do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_BEYOND = 0.5
"""Margin beyond the border in which ideal pixels are drawn, as a share of the picture's size, on each side.
"""
_FOLD_PX = 0.05
"""A pixel whose ray the lens does not send back to it, by so much, was not seen."""
_FAR_PX = 1e6
_COARSE = 8
"""That is asked of one pixel in so many, each way."""


@dataclass(frozen=True)
class Rectifier:
    """Positions of the pixels of a rectified picture (h, w) in the recorded one."""

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    """(h, w) recorded pixels."""
    seen: Image
    """(h, w) 0 where nothing was recorded."""
    first_px: Array
    """(2,) ideal pixel that the first one is, at the recorded picture's scale."""

    def picture(self, recorded: Image) -> Image:
        """Rectified; beyond its border the recorded picture is continued, not to make an edge there."""
        drawn = cv2.remap(recorded, self.x, self.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        return np.asarray(drawn, dtype=np.uint8)

    def mask(self, recorded: Image | None) -> Image:
        """Return the mask to search: 0 where nothing was recorded, or where ``recorded`` (a mask) is 0."""
        if recorded is None:
            return self.seen
        drawn = cv2.remap(recorded, self.x, self.y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT_101)
        return np.minimum(np.asarray(drawn, dtype=np.uint8), self.seen)


def rectifier(camera: Camera, size_px: tuple[int, int]) -> Rectifier | None:
    """That of a camera whose pictures were scaled to ``size_px`` (width, height); None without distortion."""
    if not camera.is_distorted:
        return None
    return _rectifier(camera.focal_px, camera.center_px, camera.size_px, camera.distortion, size_px)


@lru_cache(maxsize=4)
def _rectifier(
    focal_px: tuple[float, float],
    center_px: tuple[float, float],
    full_px: tuple[int, int],
    distortion: tuple[float, ...],
    size_px: tuple[int, int],
) -> Rectifier:
    camera, scale = Camera(focal_px, center_px, full_px, distortion), np.array(full_px) / np.array(size_px)
    first = -np.ceil(_BEYOND * np.array(size_px))
    count = np.ceil((np.array(size_px) - 2 * first) / _COARSE).astype(int)
    ideal = first + _COARSE * np.stack(np.meshgrid(*map(np.arange, count)), axis=-1)
    recorded = _recorded(camera, scale, first, _COARSE, count)
    back = camera.undistort(recorded.reshape(-1, 2)).reshape(ideal.shape)
    unfolded = np.linalg.norm(back - ((ideal + 0.5) * scale - 0.5), axis=2) < _FOLD_PX
    # A pixel between those that were asked may see the floor where any of its neighbours does.
    near = cv2.dilate((unfolded & _inside(recorded, full_px)).astype(np.uint8), np.ones((3, 3), np.uint8))
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    if len(rows) == 0:
        nowhere = np.zeros((1, 1), np.float32)
        return Rectifier(nowhere, nowhere, np.zeros((1, 1), np.uint8), np.zeros(2))
    low, last = (np.array([columns[k], rows[k]]) for k in (0, -1))
    recorded = _recorded(camera, scale, first + _COARSE * low, 1, _COARSE * (last - low + 1))
    fold = unfolded[low[1] : last[1] + 1, low[0] : last[0] + 1]
    fold = fold.repeat(_COARSE, axis=0).repeat(_COARSE, axis=1)
    seen = (255 * (_inside(recorded, full_px) & fold)).astype(np.uint8)
    at = ((recorded + 0.5) / scale - 0.5).astype(np.float32)
    return Rectifier(at[..., 0], at[..., 1], seen, first + _COARSE * low)


def _recorded(camera: Camera, scale: Array, first: Array, step: int, count: NDArray[np.int64]) -> Array:
    """(h, w, 2) recorded pixels of ideal ones: every ``step``-th from ``first`` on, ``count`` (w, h) of them,
    of a picture ``scale`` times smaller than the recorded one.
    """
    focal = np.array(camera.focal_px) / scale / step
    center = ((np.array(camera.center_px) + 0.5) / scale - 0.5 - first) / step
    matrix = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
    lens, size = np.array(camera.distortion), (int(count[0]), int(count[1]))
    maps = cv2.initUndistortRectifyMap(camera.matrix, lens, None, matrix, size, cv2.CV_32FC1)
    # What no lens does may end anywhere.
    return np.asarray(np.clip(np.nan_to_num(np.stack(maps, axis=-1), nan=-_FAR_PX), -_FAR_PX, _FAR_PX))


def _inside(recorded: Array, size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """(h, w) whether recorded pixels (h, w, 2) lie in the picture."""
    inside = ((recorded >= -0.5) & (recorded <= np.array(size_px) - 0.5)).all(axis=-1)
    return np.asarray(inside)
