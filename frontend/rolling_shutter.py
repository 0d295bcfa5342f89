"""Rolling-shutter correction: pixel positions as if all rows had been exposed at the same time.

The camera moves while it reads out its rows. Each row is displaced by the motion of the picture since the
middle row. The gyroscope measures the rotational part of that motion. The homographies to the previous and
the next picture give the rest.

Source: Forssen and Ringaby 2010 (rows rectified by the camera's own rotation); Longuet-Higgins and Prazdny
1980 (motion of a picture under rotation); the rest is the motion of a plane, which has eight parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.homography import transfer

Array = NDArray[np.float64]
RotationSinceMiddleRow = Callable[[Array], Array]
"""Map (m,) seconds after the middle row to (m, 3) rotation vectors of the camera since then, camera axes."""

_TURN_S = 0.02
"""Time before and after the middle row over which a turn is averaged: half of a common read-out time, 0.04 s
(`backend.bundle.exposure_motion`)."""
NO_TURN: Array = np.zeros(3)
_NODE_PX = 32
"""Distance of the pixels at which the displacement of rows is computed: it is smooth, and linear between."""
_FARTHEST = 10.0
"""Depth of a node, in heights of the camera, beyond which it counts as so far away: the horizon, which does
not move."""


@dataclass(frozen=True)
class NeighbourView:
    """A picture of the floor taken shortly before or after another one."""

    offset_s: float
    """Time after this picture in seconds; negative for an earlier picture."""
    other_H_this: Array
    """(3, 3) homography from undistorted pixels of this picture to pixels of the other."""


@dataclass(frozen=True)
class RowMotion:
    """Motion of a picture while its rows are read."""

    camera: Camera
    turned: RotationSinceMiddleRow
    plane: Array
    """(8,) parameters of the motion without the rotation, in focal lengths per second."""

    @staticmethod
    def estimate(
        camera: Camera, neighbours: Sequence[NeighbourView], turned: RotationSinceMiddleRow
    ) -> RowMotion:
        """Estimate it from the nearest picture before and after, from one of them, or from the rotation
        alone."""
        corners = _units(camera, camera.undistort(camera.corners_px))
        before = max((b for b in neighbours if b.offset_s < 0), key=lambda b: b.offset_s, default=None)
        after = min((b for b in neighbours if b.offset_s > 0), key=lambda b: b.offset_s, default=None)
        speeds = [(b.offset_s, _speed(camera, b, turned)) for b in (before, after) if b is not None]
        if not speeds:
            return RowMotion(camera, turned, np.zeros(8))
        if len(speeds) == 1:
            return RowMotion(camera, turned, _plane(corners, speeds[0][1]))
        (s, early), (t, late) = speeds
        # Each speed is the mean up to the other picture, so it holds half-way in time.
        return RowMotion(camera, turned, _plane(corners, (t * early - s * late) / (t - s)))

    def corner_speed(self) -> Array:
        """Return the speeds (4, 2) of the floor in the corners of the picture as the middle row is exposed,
        by velocity and turn of the camera, in focal lengths per second."""
        x = _units(self.camera, self.camera.undistort(self.camera.corners_px))
        before, after = self.turned(np.array([-_TURN_S, _TURN_S]))
        rate = np.broadcast_to((after - before) / (2 * _TURN_S), (len(x), 3))
        return np.asarray(_turning(x, rate) + _of_plane(x, self.plane))

    def to_global_shutter(self, pixel: Array) -> Array:
        """Return where undistorted pixels (n, 2) would lie if all rows were exposed with the middle row."""
        return pixel - self._moved(pixel, pixel)

    def to_rolling_shutter(self, pixel: Array) -> Array:
        """Return where pixels (n, 2) of a simultaneous exposure lie in the rolling-shutter picture."""
        seen = pixel
        for _ in range(3):
            seen = pixel + self._moved(seen, seen)
        return seen

    def _moved(self, pixel: Array, row_of: Array) -> Array:
        since_s = _since_middle(self.camera, row_of)
        x = _units(self.camera, pixel)
        moved = _turning(x, self.turned(since_s)) + since_s[:, None] * _of_plane(x, self.plane)
        return np.asarray(moved * self.camera.focal_px)


def global_shutter_homography(i_H_j: Array, i: RowMotion, j: RowMotion) -> Array:
    """Return the homography (3, 3) between global-shutter pictures from that of the recorded pictures."""
    corners = i.camera.undistort(i.camera.corners_px)
    there = i.to_global_shutter(transfer(i_H_j, j.to_rolling_shutter(corners)))
    return np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), there.astype(np.float32)))


def _since_middle(camera: Camera, pixel: Array) -> Array:
    """Return the exposure times (n,) of undistorted pixels, in seconds after the middle row."""
    row = camera.recorded(pixel)[:, 1]
    return np.asarray(camera.readout_s * (row / (camera.size_px[1] - 1) - 0.5))


def _units(camera: Camera, pixel: Array) -> Array:
    """Return positions (n, 2) in focal lengths from the optical axis."""
    return np.asarray(camera.rays(pixel)[:, :2])


def _speed(camera: Camera, neighbour: NeighbourView, turned: RotationSinceMiddleRow) -> Array:
    """Return the mean speed (4, 2) of the corners up to the other picture, without rotation, in focal
    lengths/s."""
    here = camera.undistort(camera.corners_px)
    there = transfer(neighbour.other_H_this, here)
    # A point that moves down the picture is read later in the other picture than in this one.
    rows = _since_middle(camera, there) - _since_middle(camera, here)
    took_s = neighbour.offset_s + rows
    a, b = _units(camera, here), _units(camera, there)
    turning = turned(np.array([neighbour.offset_s])).repeat(4, axis=0) / neighbour.offset_s
    return np.asarray((b - a) / took_s[:, None] - _turning(0.5 * (a + b), turning))


def _turning(x: Array, turn: Array) -> Array:
    """Return the displacements (n, 2) of points (n, 2) under small rotation vectors (n, 3) of the camera."""
    ray = np.column_stack([x, np.ones(len(x))])
    moved = -np.cross(turn, ray)
    return np.asarray(moved[:, :2] - x * moved[:, 2:])


def _of_plane(x: Array, plane: Array) -> Array:
    """Return the speeds (n, 2) of points under the motion of a plane."""
    u, v = x.T
    a, b, c, d, e, f, g, h = plane
    fold = g * u + h * v
    return np.column_stack([a * u + b * v + c - u * fold, d * u + e * v + f - v * fold])


def _plane(corners: Array, speed: Array) -> Array:
    """Return the parameters (8,) of the motion that gives four points (4, 2) their speeds (4, 2)."""
    columns = [_of_plane(corners, unit).ravel() for unit in np.eye(8)]
    return np.asarray(np.linalg.solve(np.column_stack(columns), speed.ravel()))


def picture_at_once(
    picture: NDArray[np.uint8],
    camera: Camera,
    w_T_b: Array,
    floor_z_m: float,
    moved_m: Array,
    turned_rad: Array = NO_TURN,
) -> NDArray[np.uint8]:
    """Return a picture of the floor as if all its rows had been exposed with the middle one.

    ``moved_m`` (3,): how far the camera moves, in body axes, from the exposure of the first row to that of
    the last, and ``turned_rad`` (3,): how it turns meanwhile. The floor is the plane z = ``floor_z_m``.
    """
    w, h = camera.size_px
    columns, rows = (max(2, round(side / _NODE_PX)) for side in (w, h))
    u, v = np.meshgrid(np.linspace(0, w - 1, columns), np.linspace(0, h - 1, rows))
    at = np.column_stack([u.ravel(), v.ravel()])
    ray = camera.rays(camera.undistort(at))
    w_T_c = w_T_b @ camera.b_T_c
    height, fall = w_T_c[2, 3] - floor_z_m, -ray @ w_T_c[2, :3]
    depth = np.where(fall > 1 / _FARTHEST, height / np.maximum(fall, 1 / _FARTHEST), _FARTHEST * height)
    place, b_R_c = depth[:, None] * ray, camera.b_T_c[:3, :3]
    c_moved = moved_m @ b_R_c + np.cross(turned_rad @ b_R_c, place)
    seen = at
    for _ in range(3):
        late = seen[:, 1:] / (h - 1) - 0.5
        seen = at + camera.project(place - late * c_moved) - camera.project(place)
    displaced = np.nan_to_num(seen - at).reshape(rows, columns, 2).astype(np.float32)
    node_of_pixel = np.array([[(columns - 1) / (w - 1), 0.0, 0.0], [0.0, (rows - 1) / (h - 1), 0.0]])
    right, down = (
        cv2.warpAffine(
            part,
            node_of_pixel,
            (w, h),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for part in (displaced[..., 0], displaced[..., 1])
    )
    right += np.arange(w, dtype=np.float32)
    down += np.arange(h, dtype=np.float32)[:, None]
    return np.asarray(cv2.remap(picture, right, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
