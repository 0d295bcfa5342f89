"""The camera: pictures of the floor through the true pose.

A pixel shows the mean of the floor over its footprint: the floor is sampled on a grid finer than the pixels,
from the mip level whose texels are as large as the spacing of the samples, and averaged down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from frontend.camera import Camera
from slam.simulation.sensors import Rate, generator
from slam.simulation.world import Floor, Marks, World, build_floor

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SUPERSAMPLING = 2
"""Samples along each side of a pixel."""


@dataclass(frozen=True)
class CameraModel:
    """A down-looking pinhole camera with the nose at the top of the picture."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]] = (320, 240)
    """Width, height."""
    horizontal_fov_deg: Annotated[float, Field(ge=5, le=120)] = 64.0
    rate_hz: Rate = 15.0
    noise_std: Annotated[float, Field(ge=0, le=50)] = 2.0
    """Grey levels, independent in each channel."""

    def camera(self) -> Camera:
        """Intrinsics: the field of view spans the outer borders of the picture."""
        width, height = self.size_px
        focal = width / 2 / np.tan(np.radians(self.horizontal_fov_deg) / 2)
        return Camera((focal, focal), ((width - 1) / 2, (height - 1) / 2), self.size_px)


def expose(floor: Floor, camera: Camera, w_T_b: Array) -> Image:
    """The floor as an undistorted camera at ``w_T_b`` (4, 4) sees it, without noise. (h, w, 3) BGR."""
    w_T_c = w_T_b @ camera.b_T_c
    width, height = camera.size_px
    n = SUPERSAMPLING
    spacing_m = w_T_c[2, 3] / camera.focal_px[0] / n
    level = floor.level_for(spacing_m)
    # Sample 0 lies in the outer corner of pixel 0: pixel = (sample + 1/2) / n - 1/2.
    pixel_H_sample = np.array([[1 / n, 0, 0.5 / n - 0.5], [0, 1 / n, 0.5 / n - 0.5], [0, 0, 1]])
    texel_H_sample = floor.texel_H_world(level) @ camera.floor_H_image(w_T_b) @ pixel_H_sample
    samples = cv2.warpPerspective(
        floor.levels[level],
        texel_H_sample,
        (width * n, height * n),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT,
    )
    return cv2.resize(samples, (width, height), interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class Film:
    """The pictures of a flight, each rendered when asked for and the same each time."""

    world: World
    marks: Marks
    camera: Camera
    w_T_b: Array
    """(n, 4, 4) true poses at the exposures."""
    noise_std: float
    seed: int

    def __call__(self, k: int) -> Image:
        """Picture k as (h, w, 3) BGR."""
        picture = expose(build_floor(self.world, self.marks), self.camera, self.w_T_b[k])
        if self.noise_std == 0:
            return picture
        noise = generator(self.seed, "camera", k).standard_normal(picture.shape, dtype=np.float32)
        noise *= self.noise_std
        noise += picture
        return np.clip(np.rint(noise, out=noise), 0, 255, out=noise).astype(np.uint8)
