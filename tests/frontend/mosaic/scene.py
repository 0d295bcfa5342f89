"""A floor with a known texture and pictures of it, rendered without the code under test."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from frontend.mosaic.extent import union
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.surface import Surface

Array = NDArray[np.float64]
FLOOR_Z_M = 0.25


@dataclass(frozen=True)
class Floor:
    """Texel (r, c) has its centre at x = -half + (c + 1/2) texel, y = half - (r + 1/2) texel."""

    texture: NDArray[np.uint8]
    texel_m: float

    @property
    def half_m(self) -> float:
        return self.texture.shape[0] * self.texel_m / 2

    def texel(self, x: Array, y: Array) -> tuple[Array, Array]:
        return (x + self.half_m) / self.texel_m - 0.5, (self.half_m - y) / self.texel_m - 0.5

    def at(self, x: Array, y: Array) -> Array:
        c, r = self.texel(x, y)
        return cv2.remap(self.texture, c.astype(np.float32), r.astype(np.float32), cv2.INTER_LINEAR).astype(
            float
        )


@lru_cache(maxsize=4)
def smooth_floor(seed: int, size: int = 1000, texel_m: float = 0.01, blur: float = 3.0) -> Floor:
    """Grey levels 60 to 190 with detail of some texels."""
    rng = np.random.default_rng(seed)
    noise = (rng.normal(size=(size, size, 3)).astype(np.float32) for _ in range(3))
    octaves = [cv2.GaussianBlur(n, (0, 0), s) * s for n, s in zip(noise, (blur, 10, 40), strict=True)]
    texture = sum(o / o.std() for o in octaves)
    texture = 125 + 65 * np.tanh(texture / 2)
    return Floor(texture.astype(np.uint8), texel_m)


def pose(
    x: float, y: float, height_m: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
) -> Array:
    w_T_b = np.eye(4)
    w_T_b[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    w_T_b[:3, 3] = x, y, FLOOR_Z_M + height_m
    return w_T_b


def photograph(floor: Floor, camera: Camera, w_T_b: Array, oversample: int = 3) -> NDArray[np.uint8]:
    """Each pixel is the mean over its square: ray by ray, by the textbook, lens distortion by iteration."""
    w, h = camera.size_px
    step = (np.arange(oversample) + 0.5) / oversample - 0.5
    u = (np.arange(w)[:, None] + step).ravel()
    v = (np.arange(h)[:, None] + step).ravel()
    u, v = np.meshgrid(u, v)
    xd, yd = (u - camera.center_px[0]) / camera.focal_px[0], (v - camera.center_px[1]) / camera.focal_px[1]
    k1, k2, p1, p2 = camera.distortion[:4]
    x, y = xd.copy(), yd.copy()
    for _ in range(20 if any(camera.distortion) else 0):
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2
        x, y = (
            (xd - 2 * p1 * x * y - p2 * (r2 + 2 * x**2)) / radial,
            (yd - p1 * (r2 + 2 * y**2) - 2 * p2 * x * y) / radial,
        )
    w_T_c = w_T_b @ camera.b_T_c
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ w_T_c[:3, :3].T
    s = (FLOOR_Z_M - w_T_c[2, 3]) / ray[..., 2]
    c, r = floor.texel(w_T_c[0, 3] + s * ray[..., 0], w_T_c[1, 3] + s * ray[..., 1])
    fine = cv2.remap(floor.texture, c.astype(np.float32), r.astype(np.float32), cv2.INTER_LINEAR)
    mean = fine.reshape(h, oversample, w, oversample, 3).astype(float).mean(axis=(1, 3))
    return np.clip(np.rint(mean), 0, 255).astype(np.uint8)


def survey(seed: int, rows: int = 3, cols: int = 4, spacing_m: float = 0.9, tilt_rad: float = 0.08) -> Array:
    """(n, 4, 4) poses about 2 m above the floor in strips, any yaw, some tilt."""
    rng = np.random.default_rng(seed)
    poses = []
    for i in range(rows):
        for j in range(cols):
            x, y = (j - (cols - 1) / 2) * spacing_m, (i - (rows - 1) / 2) * spacing_m
            poses.append(
                pose(
                    x + rng.normal(0, 0.05),
                    y + rng.normal(0, 0.05),
                    2 * rng.uniform(0.9, 1.1),
                    rng.uniform(-np.pi, np.pi),
                    *rng.normal(0, tilt_rad, 2),
                )
            )
    return np.array(poses)


CAMERA = Camera((200.0, 200.0), (99.5, 74.5), (200, 150))
"""At 2 m: 1 cm a pixel, 2 m by 1.5 m."""


def over_depth(flat: MosaicPlan, poses: Array, depth_m: float) -> MosaicPlan:
    """The same plan of a level floor, whose heights count from a floor that lies lower by ``depth_m``."""
    bounds_m = {view.k: view.bounds_m for view in flat.all_views(poses)}
    west, south, east, north = union(np.array(list(bounds_m.values())))
    cell_m = 0.05
    shape = int((north - south) / cell_m) + 1, int((east - west) / cell_m) + 1
    height_m = np.full(shape, depth_m, np.float32)
    surface = Surface(west, north, cell_m, height_m, np.zeros_like(height_m), np.zeros(shape, np.uint8))
    return plan_mosaic(
        flat.camera, poses, flat.floor_z_m - depth_m, flat.gsd_m, surface=surface, bounds_m=bounds_m
    )
