"""The optics of the camera: pictures of a scene from the true pose.

A pixel shows the mean of the scene over its footprint. The scene is sampled on a grid finer than the pixels
and averaged. The samples come from the mip level whose texels are as large as their spacing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from frontend.camera import Camera, Intrinsics
from slam.simulation.place.ground import Ground
from slam.simulation.place.obstacles import corners
from slam.simulation.place.scene import Scene
from slam.simulation.sensors import Rate

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SUPERSAMPLING = 2
"""Samples along each side of a pixel."""
PIXEL_H_SAMPLE: Array = np.array(
    [
        [1 / SUPERSAMPLING, 0, 0.5 / SUPERSAMPLING - 0.5],
        [0, 1 / SUPERSAMPLING, 0.5 / SUPERSAMPLING - 0.5],
        [0, 0, 1],
    ]
)
"""Homography from samples to pixels: pixel = (sample + 1/2) / n - 1/2, so sample 0 is in a pixel's corner."""
COARSE = 8
SKY = 1e4
"""Length of a ray, in lengths of its direction, at which it counts as leaving to the sky."""
NEAR_M = 0.02
"""Least distance at which a point is visible."""
FOLD_PX = 0.05
"""Largest error of undistortion followed by distortion; a pixel with a larger one is dark."""


@dataclass(frozen=True)
class CameraModel:
    """A downward camera with the nose at the top of the picture; the default is that of the paper's drone."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]] = (176, 144)
    """Width and height."""
    horizontal_fov_deg: Annotated[float, Field(ge=5, le=120)] = 64.0
    rate_hz: Rate = 15.0
    noise_std: Annotated[float, Field(ge=0, le=50)] = 2.0
    """Standard deviation in grey levels, independent in each channel."""
    saturation: Annotated[float, Field(ge=0, le=2)] = 1.0
    """Strength of colours; 0 is grey."""
    brightness: Annotated[float, Field(gt=0, le=4)] = 1.0
    """Factor of all grey levels."""
    down_sampling: Annotated[float, Field(ge=1, le=16)] = 1.0
    """Factor by which pictures are scaled down and up again."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """OpenCV's k1, k2, p1, p2, reported in the flight."""

    def camera(self) -> Camera:
        """Return the intrinsics, and a mount that is told to be exact. Without distortion the field of view
        spans the outer borders of the picture."""
        width, height = self.size_px
        focal = width / 2 / np.tan(np.radians(self.horizontal_fov_deg) / 2)
        center = ((width - 1) / 2, (height - 1) / 2)
        return Camera(
            focal_px=(focal, focal),
            center_px=center,
            size_px=self.size_px,
            distortion=self.distortion,
            mount_std_rad=0.0,
        )


def expose(scene: Scene, camera: Camera, w_T_b: Array, time_s: float = 0.0) -> Image:
    """Return the picture (h, w, 3) BGR of a scene at one time, from the body pose ``w_T_b`` (4, 4).

    It has no noise.
    """
    w_T_c = w_T_b @ camera.b_T_c
    samples = sample(scene, camera, w_T_c[None, :3, :3], w_T_c[None, :3, 3], scene.prisms(time_s))
    return np.asarray(cv2.resize(samples, camera.size_px, interpolation=cv2.INTER_AREA))


def sample(scene: Scene, camera: Camera, w_R_c: Array, w_t_c: Array, prisms: Array) -> Image:
    """Return n = ``SUPERSAMPLING`` samples along each side of each pixel, (h n, w n, 3) BGR.

    ``w_R_c`` (1 or h n, 3, 3) and ``w_t_c`` (1 or h n, 3) are the camera's pose, one for all rows or one for
    each row of samples.
    """
    size = (camera.size_px[0] * SUPERSAMPLING, camera.size_px[1] * SUPERSAMPLING)
    grid = _grid(camera.intrinsics)
    middle = len(w_t_c) // 2
    spacing = 1 / camera.focal_px[0] / SUPERSAMPLING
    level = scene.floor.level_for(max(_height(w_t_c[middle], scene.ground), 1e-3) * spacing)
    texel_H_world, texels = scene.floor.texel_H_world(level), scene.floor.levels[level]
    texel_H_ray = texel_H_world @ _floor_H_ray(w_R_c, w_t_c, scene.ground.slope)
    if scene.ground.hills:
        x, y = _texels_on_hills(scene.ground, texel_H_world, grid.rays, w_R_c, w_t_c)
        samples = cv2.remap(texels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    elif len(w_t_c) == 1 and not camera.is_distorted:
        warp = texel_H_ray[0] @ np.linalg.inv(camera.matrix) @ PIXEL_H_SAMPLE
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        samples = cv2.warpPerspective(texels, warp, size, flags=flags, borderMode=cv2.BORDER_REFLECT)
    else:
        x, y = _projected(texel_H_ray, grid.rays)
        samples = cv2.remap(texels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    samples = cv2.cvtColor(samples, cv2.COLOR_BGRA2BGR)
    if len(prisms) > 0:
        _draw_obstacles(samples, scene, camera, grid, w_R_c, w_t_c, prisms)
    if grid.dark is not None:
        samples[grid.dark] = 0
    return np.asarray(samples)


@dataclass(frozen=True)
class _Grid:
    rays: NDArray[np.float32]
    """(h n, w n, 2) direction of each sample in camera axes with z = 1."""
    dark: NDArray[np.bool_] | None
    """(h n, w n) samples without light, outside the invertible part of the distortion."""


@lru_cache(maxsize=4)
def _grid(intrinsics: Intrinsics) -> _Grid:
    camera, (width, height) = intrinsics.camera(), intrinsics.size_px
    u, v = ((np.arange(size * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5 for size in (width, height))
    pixel = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    rays = camera.rays(camera.undistort(pixel))
    dark = None
    if camera.is_distorted:
        with np.errstate(invalid="ignore", over="ignore"):
            lost = ~(np.linalg.norm(camera.project(rays) - pixel, axis=1) < FOLD_PX)
        rays[lost] = 0
        dark = lost.reshape(len(v), len(u)) if lost.any() else None
    return _Grid(np.ascontiguousarray(rays[:, :2].reshape(len(v), len(u), 2), dtype=np.float32), dark)


def _height(w_t_c: Array, ground: Ground) -> float:
    """Return the vertical height of a point above the ground."""
    return float(w_t_c[2] - ground.height(w_t_c[0], w_t_c[1]))


def _texels_on_hills(
    ground: Ground, texel_H_world: Array, rays: NDArray[np.float32], w_R_c: Array, w_t_c: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the texels (h, w) where rays (h, w, 2) meet hilly ground; those to the sky lie off the floor."""
    # Imported here because it compiles on import, which flat ground does not need.
    from slam.simulation.place.casting import ground_ranges

    rows, cols = rays.shape[:2]
    ahead = np.concatenate([rays, np.ones((rows, cols, 1), np.float32)], axis=-1).astype(float)
    direction = (ahead @ w_R_c.transpose(0, 2, 1)).reshape(-1, 3)
    origin = w_t_c if len(w_t_c) == 1 else np.repeat(w_t_c, cols, axis=0)
    s = ground_ranges(np.ascontiguousarray(origin), direction, np.array(ground.slope), ground.hill_rows)
    world = origin[:, :2] + np.minimum(s, SKY)[:, None] * direction[:, :2]
    texel = (world @ texel_H_world[:2, :2].T + texel_H_world[:2, 2]).astype(np.float32)
    return texel[:, 0].reshape(rows, cols), texel[:, 1].reshape(rows, cols)


def _floor_H_ray(w_R_c: Array, w_t_c: Array, slope: tuple[float, float]) -> Array:
    """Return homographies (m, 3, 3) from camera directions to world (x, y) on the floor z = slope . (x, y).

    The ray t + s R d meets the floor at s = -h / ((R d)_z - slope . (R d)_xy), with the height h above it.
    The result is multiplied by that denominator.
    """
    above = w_t_c[:, 2] - w_t_c[:, :2] @ slope
    sinks = w_R_c[:, 2] - np.einsum("mij,i->mj", w_R_c[:, :2], np.array(slope))
    across = w_t_c[:, :2, None] * sinks[:, None] - above[:, None, None] * w_R_c[:, :2]
    return np.concatenate([across, sinks[:, None]], axis=1)


def _projected(H: Array, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Map rays (h, w, 2) by one homography, or by one for each row: (1 or h, 3, 3)."""
    if len(H) == 1:
        at = cv2.perspectiveTransform(rays, H[0])
        return at[..., 0], at[..., 1]
    u, v = rays[..., 0], rays[..., 1]
    row = H.astype(np.float32)[..., None]
    x, y, w = (row[:, i, 0] * u + row[:, i, 1] * v + row[:, i, 2] for i in range(3))
    return x / w, y / w


def _draw_obstacles(
    samples: Image, scene: Scene, camera: Camera, grid: _Grid, w_R_c: Array, w_t_c: Array, prisms: Array
) -> None:
    bounds = _bounds(prisms, camera, grid, w_R_c, w_t_c)
    seen = (bounds[:, 0] <= bounds[:, 1]) & (bounds[:, 2] <= bounds[:, 3])
    if not seen.any():
        return
    # Imported here because it compiles on import, which a scene without obstacles does not need.
    from slam.simulation.place import casting, textures

    spacing = 1 / camera.focal_px[0] / SUPERSAMPLING
    view = casting.SampleRays(grid.rays, np.ascontiguousarray(w_R_c), np.ascontiguousarray(w_t_c), spacing)
    visible = casting.VisiblePrisms(
        prisms[seen],
        bounds[seen],
        scene.textures.texels,
        scene.textures.levels[seen],
        textures.METRES_PER_TEXEL,
    )
    casting.draw(samples, view, np.array(scene.ground.slope), scene.ground.hill_rows, visible)


def _bounds(prisms: Array, camera: Camera, grid: _Grid, w_R_c: Array, w_t_c: Array) -> NDArray[np.int64]:
    """Return first and last row, first and last column (n, 4) of the samples that each prism may cover."""
    w_p = np.array([corners(prism) for prism in prisms])
    reach, lost = [], np.zeros(len(prisms), bool)
    for k in {0, len(w_t_c) // 2, len(w_t_c) - 1}:
        c_p = (w_p - w_t_c[k]) @ w_R_c[k]
        lower, upper = c_p[:, :4], c_p[:, 4:]
        # A tall prism is cut just below the camera.
        rise = np.maximum(lower[..., 2] - upper[..., 2], 1e-9)
        share = np.clip((lower[..., 2] - NEAR_M) / rise, 0, 1)[..., None]
        cut = np.concatenate([lower, lower + share * (upper - lower)], axis=1)
        reach.append(cut[..., :2] / np.maximum(cut[..., 2:], NEAR_M))
        lost |= (lower[..., 2] < NEAR_M).any(1)
    low, high = np.hstack(reach).min(1), np.hstack(reach).max(1)
    # If the foot is next to or behind the camera, corners do not bound the picture of the prism.
    low[lost], high[lost] = -np.inf, np.inf
    # Every eighth ray is tested; rows between the three poses may extend a little further.
    spacing = 1 / camera.focal_px[0] / SUPERSAMPLING
    slack = 2 * COARSE * spacing + (0.1 * (high - low) if len(w_t_c) > 1 else 0.0)
    rays = grid.rays[::COARSE, ::COARSE]
    low, high = low - slack, high + slack
    bounds = np.tile(np.array([0, -1, 0, -1]), (len(prisms), 1))
    near = (low <= rays.max((0, 1))).all(1) & (high >= rays.min((0, 1))).all(1)
    for seen in np.flatnonzero(near):
        within = ((rays >= low[seen]) & (rays <= high[seen])).all(2)
        for axis in (0, 1):
            hit = np.flatnonzero(within.any(1 - axis)) * COARSE
            if len(hit):
                last = grid.rays.shape[axis] - 1
                bounds[seen, 2 * axis : 2 * axis + 2] = np.clip([hit[0] - COARSE, hit[-1] + COARSE], 0, last)
    return bounds
