"""Overlay of two pictures by the floor's homography. Where they still differ, something else than the floor
is visible."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera, Intrinsics
from frontend.homography import transfer

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

WIDTH_PX = 176


@dataclass(frozen=True)
class Overlaid:
    """Picture j warped into picture i by the floor's homography, of the size (h, w) of a reduced i."""

    seen: NDArray[np.bool_]
    """(h, w) mask of pixels that lie inside both pictures."""
    other: NDArray[np.float32]
    """(h, w) grey levels of j, scaled to those of i by one factor."""
    was_px: Array
    """(h, w, 2) undistorted pixel in j, at the camera's full size."""
    is_px: Array
    """(h, w, 2) undistorted pixel in i, at the camera's full size."""


def reduced(image: Image) -> Image:
    """Return a grey picture of at most ``WIDTH_PX`` columns, in which fine detail is averaged out."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return shrunk(np.asarray(grey, dtype=np.uint8), WIDTH_PX)


def shrunk(image: Image, width_px: int) -> Image:
    """Return the grey picture (h, w) reduced to at most ``width_px`` columns."""
    height, width = image.shape
    if width <= width_px:
        return image
    size = (width_px, round(height * width_px / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def overlaid(small_i: Image, small_j: Image, i_H_j: Array, camera: Camera) -> Overlaid:
    """Overlay two reduced pictures of one camera. ``i_H_j`` maps its undistorted pixels by the floor."""
    is_px = pixels(small_i.shape, camera)
    was_px = transfer(np.asarray(np.linalg.inv(i_H_j), dtype=np.float64), is_px)
    scale = camera.size_px[0] / small_j.shape[1]
    at = camera.project(camera.rays(was_px)) if camera.is_distorted else was_px
    at = ((at + 0.5) / scale - 0.5).astype(np.float32).reshape(*small_i.shape, 2)
    height, width = small_j.shape
    seen = (at >= 0).all(axis=2) & (at[..., 0] <= width - 1) & (at[..., 1] <= height - 1)
    other = cv2.remap(small_j.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    if seen.any():
        other *= float(np.median((small_i[seen] + 1.0) / (other[seen] + 1.0)))
    grid = (*small_i.shape, 2)
    return Overlaid(seen, other, was_px.reshape(grid), is_px.reshape(grid))


def pixels(shape: tuple[int, ...], camera: Camera) -> Array:
    """Return (h w, 2) undistorted pixels at the camera's full size, at the centres of a reduced picture's."""
    return _pixels(shape, camera.intrinsics)


@lru_cache(maxsize=4)
def _pixels(shape: tuple[int, ...], intrinsics: Intrinsics) -> Array:
    scale = intrinsics.size_px[0] / shape[1]
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    grid = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64) + 0.5
    return intrinsics.camera().undistort(grid * scale - 0.5)
