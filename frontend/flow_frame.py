"""Pictures as optical flow compares them: reduced, rectified, and of the same contrast everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_SIDE_PX = 640
"""Larger pictures are reduced to this side: the flow is then still as exact as SIFT at full size."""
WINDOW_PX = 21
"""Side of the compared windows."""
CONTRAST, MIDDLE, DARK_STD = 40.0, 128.0, 2.0
"""Grey levels of one local standard deviation and of the local mean in a normalised picture, and the standard
deviation in grey levels below which the contrast is noise and is not amplified."""


@dataclass(frozen=True)
class FlowFrame:
    """Pixels of the compared pictures of a camera."""

    camera: Camera

    @cached_property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the compared pictures."""
        full = np.array(self.camera.size_px)
        width, height = np.rint(full * min(1.0, MAX_SIDE_PX / full.max())).astype(int).tolist()
        return width, height

    @cached_property
    def scale(self) -> Array:
        """(2,) size of the camera's pictures over that of the compared ones."""
        return np.array(self.camera.size_px) / self.size_px

    @cached_property
    def reduced_H_full(self) -> Array:
        """(3, 3) pixels of the camera's pictures -> pixels of the compared ones."""
        (sx, sy), shift = 1 / self.scale, 0.5 / self.scale - 0.5
        return np.array([[sx, 0, shift[0]], [0, sy, shift[1]], [0, 0, 1.0]])

    def grey(self, image: Image) -> Image:
        """Return a picture of the camera, (h, w) or (h, w, 3), as a grey one of the compared size."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        if grey.shape[::-1] != self.size_px:
            grey = cv2.resize(grey, self.size_px, interpolation=cv2.INTER_AREA)
        return np.asarray(grey, dtype=np.uint8)

    def warped(self, grey: Image, i_H_j: Array) -> Image:
        """Return the normalised grey picture j as an ideal lens would have seen it from picture i."""
        to, border = self.reduced_H_full, cv2.BORDER_REPLICATE
        H = to @ i_H_j @ np.linalg.inv(to)
        if self.camera.is_distorted:
            K = to @ self.camera.matrix
            at = self.camera.recorded_maps(H @ K, self.size_px, K)
            warped = cv2.remap(grey, *at, cv2.INTER_LINEAR, borderMode=border)
        else:
            warped = cv2.warpPerspective(grey, H, self.size_px, flags=cv2.INTER_LINEAR, borderMode=border)
        return _normalised(np.asarray(warped, dtype=np.uint8))

    def shows(self, pixel: Array, mask: Image | None) -> NDArray[np.bool_]:
        """Return (m,) whether the windows about undistorted pixels (m, 2) were recorded, and their middles
        are not masked."""
        camera, margin = self.camera, 0.5 * WINDOW_PX * self.scale
        recorded = camera.recorded(pixel)
        inside = np.asarray(
            ((recorded > margin) & (recorded < np.array(camera.size_px) - 1 - margin)).all(axis=1),
            dtype=np.bool_,
        )
        if mask is not None:
            column, row = np.rint(recorded[inside]).astype(int).T
            inside[inside] = mask[row, column] > 0
        return inside


def _normalised(grey: Image) -> Image:
    """Return the picture with the same mean and contrast everywhere.

    Flow compares grey levels: a change of exposure, a lens that is darker at its edge or a shadow would
    displace the windows.
    """
    around = (2 * WINDOW_PX + 1,) * 2
    mean = cv2.boxFilter(grey, cv2.CV_32F, around)
    variance = cv2.subtract(cv2.sqrBoxFilter(grey, cv2.CV_32F, around), cv2.multiply(mean, mean))
    std = cv2.sqrt(cv2.add(variance, DARK_STD**2))
    contrast = cv2.divide(cv2.subtract(grey, mean, dtype=cv2.CV_32F), std, scale=CONTRAST)
    return np.asarray(cv2.add(contrast, MIDDLE, dtype=cv2.CV_8U), dtype=np.uint8)
