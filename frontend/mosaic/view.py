"""Projection of a floor lattice into a picture, with visibility and resolution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera, Intrinsics

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

TABLE_PX = 4.0
"""Distance of the nodes between which the distortion is interpolated. `cv2.remap` rounds positions to 1/32 of
it, which is an error of 0.01 px where distortion stretches the picture by 10 %."""
MAX_OFF_NADIR = np.radians(70.0)
"""Largest angle of a ray off nadir. Floor seen at a larger angle is not used: a pixel of it is
1 / cos(70 deg)^1.5 = 5 times as wide as straight below, and 3 times as long as it is wide."""


@dataclass(frozen=True)
class MosaicView:
    """One picture that looks at the floor."""

    k: int
    """Number of its pose."""
    pixel_H_floor: Array
    """(3, 3) map from floor (x, y, 1) in metres to undistorted pixels times the depth on the optical axis."""
    w_p_c_m: Array
    """(3,) camera position."""
    height_m: float
    """Height of the camera above the floor."""
    bounds_m: Array
    """(4,) west, south, east and north bounds of the visible ground."""
    outline_m: Array
    """(n, 2) border of the visible floor, point by point around it."""
    gsd_m: float
    """Ground sample distance in the centre of the picture, or where it ends if the centre is beyond that."""
    max_off_axis_cos: float
    """Cosine of the largest angle off the optical axis. The distortion model is invalid beyond it."""

    def in_field(self, depth: Float32 | Array, distance: Float32 | Array) -> Mask:
        """Return whether the lens sees points by their depth along the optical axis and their distance.

        Beyond its largest angle, the polynomial of a lens may turn back and show the picture again.
        """
        return np.asarray(depth > distance * np.float32(self.max_off_axis_cos - 1e-6))

    @property
    def nadir_gsd_m(self) -> float:
        """Ground sample distance that the picture would have if it looked straight down."""
        return float(np.sqrt(self.height_m**3 / abs(np.linalg.det(self.pixel_H_floor))))

    def outline_within(self, gsd_m: float) -> Array:
        """Return the border (n, 2) of the floor that has at most this ground sample distance."""
        # It is sqrt(depth^3 / det H), as in `visible`, and the depth is linear on the floor.
        depth_m = np.cbrt(gsd_m**2 * abs(np.linalg.det(self.pixel_H_floor)))
        return clipped(self.outline_m, np.array([0.0, 0.0, depth_m]) - self.pixel_H_floor[2])


@dataclass(frozen=True)
class Lattice:
    """Part of a regular grid over the floor, rows to the south."""

    x0_m: float
    y0_m: float
    """Floor position of the first node."""
    step_m: float
    rows: int
    cols: int


def mosaic_view(
    camera: Camera, k: int, w_T_b: Array, floor_z_m: float, bounds_m: Array | None = None
) -> MosaicView | str:
    """Return the view of picture k, or the reason why it is unusable.

    ``bounds_m`` (4,) are those of ground that is not the floor, such as a hillside.
    """
    if not np.isfinite(w_T_b).all():
        return "not placed"
    w_T_c = w_T_b @ camera.b_T_c
    height = float(w_T_c[2, 3] - floor_z_m)
    if height <= 0:
        return "camera below the floor"
    pixel_H_floor = np.linalg.inv(camera.floor_H_image(w_T_b, floor_z_m))
    rays = camera.rays(camera.undistort(_border(camera)))
    off_axis_cos = 1.0 / np.linalg.norm(rays, axis=1)
    # Rays are clipped at the limit, so that the near part of a picture with the horizon is kept.
    direction = rays @ w_T_c[:3, :3].T
    level = np.linalg.norm(direction[:, :2], axis=1)
    slope = np.divide(level, -direction[:, 2], out=np.full(len(level), np.inf), where=direction[:, 2] < 0)
    # A wide lens may show what is straight below with all of its border beyond.
    axis_is_near = -w_T_c[2, 2] > np.cos(MAX_OFF_NADIR)
    if not axis_is_near and slope.min() >= np.tan(MAX_OFF_NADIR):
        return "looks towards the horizon"
    reach = height * np.minimum(slope, np.tan(MAX_OFF_NADIR))
    edge = w_T_c[:2, 3] + direction[:, :2] / np.maximum(level, 1e-12)[:, None] * reach[:, None]
    depth = height / max(-w_T_c[2, 2], np.cos(MAX_OFF_NADIR))
    gsd = float(np.sqrt(depth**3 / abs(np.linalg.det(pixel_H_floor))))
    bounds = bounds_of(edge) if bounds_m is None else bounds_m
    return MosaicView(
        k=k,
        pixel_H_floor=np.asarray(pixel_H_floor, float),
        w_p_c_m=w_T_c[:3, 3],
        height_m=height,
        bounds_m=bounds,
        outline_m=edge,
        gsd_m=gsd,
        max_off_axis_cos=float(off_axis_cos.min()),
    )


def bounds_of(outline_m: Array) -> Array:
    """Return the bounds (4,) of points (n, 2)."""
    return np.concatenate([outline_m.min(axis=0), outline_m.max(axis=0)])


def clipped(outline: Array, line: Array) -> Array:
    """Return the part (m, 2) of a convex polygon (n, 2) where a x + b y + c >= 0, for ``line`` (a, b, c).

    A polygon that lies there as a whole is returned itself. Source: Sutherland and Hodgman 1974, Reentrant
    polygon clipping.
    """
    side = outline @ line[:2] + line[2]
    if (side >= 0).all():
        return outline
    following, side_there = np.roll(outline, -1, axis=0), np.roll(side, -1)
    crosses = (side >= 0) != (side_there >= 0)
    share = np.divide(side, side - side_there, out=np.zeros_like(side), where=crosses)
    crossing = outline + share[:, None] * (following - outline)
    points = np.stack([outline, crossing], axis=1).reshape(-1, 2)
    return np.asarray(points[np.stack([side >= 0, crosses], axis=1).ravel()])


def _border(camera: Camera) -> Array:
    """(64, 2) pixels along the border of the picture."""
    t = np.linspace(0, 1, 16, endpoint=False)
    corner = camera.corners_px
    sides = [corner[i] + t[:, None] * (corner[(i + 1) % 4] - corner[i]) for i in range(4)]
    return np.concatenate(sides)


def pixel_maps(camera: Camera, view: MosaicView, lattice: Lattice) -> tuple[Float32, Float32]:
    """Return the distorted pixel (u, v) of each node of the lattice, undefined behind the camera."""
    floor_H_node = np.array(
        [[lattice.step_m, 0, lattice.x0_m], [0, -lattice.step_m, lattice.y0_m], [0, 0, 1.0]]
    )
    ray_H_node = np.linalg.inv(camera.matrix) @ view.pixel_H_floor @ floor_H_node
    return homography_maps(camera, ray_H_node, lattice.rows, lattice.cols)


def homography_maps(camera: Camera, ray_H_node: Array, rows: int, cols: int) -> tuple[Float32, Float32]:
    """Return the distorted pixel (u, v) (rows, cols) of nodes whose rays a homography (3, 3) gives."""
    return _clipped(camera, *camera.recorded_maps(np.asarray(np.linalg.inv(ray_H_node), float), (cols, rows)))


def raised_maps(
    camera: Camera, view: MosaicView, lattice: Lattice, height_m: Float32
) -> tuple[Float32, Float32]:
    """Return the distorted pixel (u, v) of the ground (rows, cols) at a height over each node."""
    x = lattice.x0_m + lattice.step_m * np.arange(lattice.cols)
    y = lattice.y0_m - lattice.step_m * np.arange(lattice.rows)
    ray_H_floor = np.linalg.inv(camera.matrix) @ view.pixel_H_floor
    # The camera itself has no direction, which gives the change of direction with the height.
    up = -ray_H_floor @ (*view.w_p_c_m[:2], 1.0) / view.height_m
    ray = [
        (a * x + c)[None] + (b * y)[:, None] + rise * height_m
        for (a, b, c), rise in zip(ray_H_floor, up, strict=True)
    ]
    depth = np.where(ray[2] > 0, ray[2], np.nan)
    (fu, fv), (cu, cv) = camera.focal_px, camera.center_px
    u, v = fu * ray[0] / depth + cu, fv * ray[1] / depth + cv
    if camera.is_distorted:
        return _distorted(camera, u.astype(np.float32), v.astype(np.float32))
    return _clipped(camera, u.astype(np.float32), v.astype(np.float32))


def _distorted(camera: Camera, u: Float32, v: Float32) -> tuple[Float32, Float32]:
    """Return distorted pixels of undistorted ones, by interpolation in a table of the displacements.

    What lies outside the table lies outside the picture.
    """
    low, moved = _displacements(camera.intrinsics)
    at = (u - low[0]) / np.float32(TABLE_PX), (v - low[1]) / np.float32(TABLE_PX)
    du, dv = (cv2.remap(table, *at, cv2.INTER_LINEAR, borderValue=np.nan) for table in moved)
    return _clipped(camera, u + du, v + dv)


@lru_cache(maxsize=2)  # Small lattices are many, and the table covers a whole picture.
def _displacements(lens: Intrinsics) -> tuple[Float32, tuple[Float32, Float32]]:
    """Return the first node (2,) of a table over the picture, and the displacements (u, v) of its nodes."""
    camera = lens.camera()
    edge = camera.undistort(_border(camera))
    low = np.floor(edge.min(axis=0)) - 2 * TABLE_PX
    cols, rows = (np.ceil((edge.max(axis=0) - low) / TABLE_PX).astype(int) + 3).tolist()
    undistorted_H_node = np.array([[TABLE_PX, 0, low[0]], [0, TABLE_PX, low[1]], [0, 0, 1.0]])
    u, v = homography_maps(camera, np.linalg.inv(camera.matrix) @ undistorted_H_node, rows, cols)
    nodes = low[0] + TABLE_PX * np.arange(cols)[None], low[1] + TABLE_PX * np.arange(rows)[:, None]
    return low.astype(np.float32), ((u - nodes[0]).astype(np.float32), (v - nodes[1]).astype(np.float32))


def _clipped(camera: Camera, u: Float32, v: Float32) -> tuple[Float32, Float32]:
    # Clipping keeps the values finite at the horizon. Far outside, only mirrored content is read.
    w, h = (np.float32(side) for side in camera.size_px)
    for at, side in ((u, w), (v, h)):  # The larger of NaN and a number is the number.
        np.fmin(np.fmax(at, -side, out=at), 2 * side, out=at)
    return u, v


def visible(
    view: MosaicView, lattice: Lattice, height_m: Float32 | None = None
) -> tuple[Mask, Float32, Float32]:
    """Return (rows, cols) whether the lens sees each node, its cosine off nadir, and the pixels per metre.

    The nodes lie at ``height_m`` (rows, cols) over the floor, on the floor itself for None. Those at more
    than ``MAX_OFF_NADIR`` count as not seen.
    """
    x = lattice.x0_m + lattice.step_m * np.arange(lattice.cols)
    y = lattice.y0_m - lattice.step_m * np.arange(lattice.rows)
    a, b, c = view.pixel_H_floor[2]
    depth = ((a * x + c)[None] + (b * y)[:, None]).astype(np.float32)
    dx2, dy2 = (x - view.w_p_c_m[0]) ** 2, (y - view.w_p_c_m[1]) ** 2
    below: Float32 | np.float32 = np.float32(view.height_m)
    # Jacobian determinant of a homography: det(H) / depth^3 (Hartley and Zisserman 2004, section 2.3). For
    # another height, det(H) is in proportion to the height of the camera over it.
    scale: Float32 | np.float32 = np.float32(abs(np.linalg.det(view.pixel_H_floor)))
    if height_m is not None:
        below = np.maximum(below - height_m, np.float32(1e-3))
        scale = scale * below / np.float32(view.height_m)
        # The camera itself has no depth, so that the depth of the floor below it tells the change.
        depth -= np.float32(view.pixel_H_floor[2] @ (*view.w_p_c_m[:2], 1.0) / view.height_m) * height_m
    distance = np.sqrt((dx2[None] + dy2[:, None]).astype(np.float32) + below**2)
    seen = view.in_field(depth, distance) & (distance < below / np.cos(MAX_OFF_NADIR))
    resolution = np.sqrt(scale / np.where(seen, depth, np.float32(np.inf)) ** 3)
    return seen, below / distance, resolution
