"""Pictures whose rows are exposed one after the other: where things would lie had all been exposed at once.

While the camera reads out its rows, it moves on: what each row shows is off by the picture's own motion since
the middle row. That motion is what a gyro says of the turning, and for the rest what lies between this
picture and the ones just before and after it.

Source: Forssen and Ringaby 2010 (rows rectified by the camera's own rotation); Longuet-Higgins and Prazdny
1980 (motion of a picture by turning); the rest is that of a plane, eight numbers.
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
"""(m,) seconds after the middle row's -> (m, 3) rotation vector of the camera since then, in its axes."""


@dataclass(frozen=True)
class NeighbourView:
    """Another picture of the floor, a little before or after."""

    offset_s: float
    """Negative: before."""
    other_H_this: Array
    """(3, 3) undistorted pixels of this picture to pixels of the other."""


@dataclass(frozen=True)
class RowMotion:
    """How a picture moves while its rows are read."""

    camera: Camera
    turned: RotationSinceMiddleRow
    plane: Array
    """(8,) numbers of what is left of the motion once turning is taken out, in focal lengths a second."""

    @staticmethod
    def estimate(
        camera: Camera, neighbours: Sequence[NeighbourView], turned: RotationSinceMiddleRow
    ) -> RowMotion:
        """From the nearest picture before and after, one of them, or turning alone."""
        corners = _units(camera, camera.undistort(camera.corners_px))
        before = max((b for b in neighbours if b.offset_s < 0), key=lambda b: b.offset_s, default=None)
        after = min((b for b in neighbours if b.offset_s > 0), key=lambda b: b.offset_s, default=None)
        speeds = [(b.offset_s, _speed(camera, b, turned)) for b in (before, after) if b is not None]
        if not speeds:
            return RowMotion(camera, turned, np.zeros(8))
        if len(speeds) == 1:
            return RowMotion(camera, turned, _plane(corners, speeds[0][1]))
        (s, early), (t, late) = speeds
        # Each is the mean up to the other picture: that of the time half-way.
        return RowMotion(camera, turned, _plane(corners, (t * early - s * late) / (t - s)))

    def to_global_shutter(self, pixel: Array) -> Array:
        """Undistorted pixels (n, 2) where they would lie had every row been exposed with the middle one."""
        return pixel - self._moved(pixel, pixel)

    def to_rolling_shutter(self, pixel: Array) -> Array:
        """The inverse: where pixels (n, 2) of one moment are found among rows of many."""
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
    """(3, 3) of two pictures had each been exposed at once, from that of the pictures as they are."""
    corners = i.camera.undistort(i.camera.corners_px)
    there = i.to_global_shutter(transfer(i_H_j, j.to_rolling_shutter(corners)))
    return np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), there.astype(np.float32)))


def _since_middle(camera: Camera, pixel: Array) -> Array:
    """(n,) seconds after the middle row at which undistorted pixels were exposed."""
    row = camera.project(camera.rays(pixel))[:, 1] if camera.is_distorted else pixel[:, 1]
    return np.asarray(camera.readout_s * (row / (camera.size_px[1] - 1) - 0.5))


def _units(camera: Camera, pixel: Array) -> Array:
    """(n, 2) in focal lengths from the optical axis."""
    return np.asarray(camera.rays(pixel)[:, :2])


def _speed(camera: Camera, neighbour: NeighbourView, turned: RotationSinceMiddleRow) -> Array:
    """(4, 2) mean speed of the corners up to the other picture, turning taken out, in focal lengths per s."""
    here = camera.undistort(camera.corners_px)
    there = transfer(neighbour.other_H_this, here)
    # What moves down the picture is read later in the other one than in this.
    rows = _since_middle(camera, there) - _since_middle(camera, here)
    took_s = neighbour.offset_s + rows
    a, b = _units(camera, here), _units(camera, there)
    turning = turned(np.array([neighbour.offset_s])).repeat(4, axis=0) / neighbour.offset_s
    return np.asarray((b - a) / took_s[:, None] - _turning(0.5 * (a + b), turning))


def _turning(x: Array, turn: Array) -> Array:
    """(n, 2) by how much points (n, 2) of a picture move where the camera turns by small vectors (n, 3)."""
    (u, v), (p, q, r) = x.T, turn.T
    return np.column_stack([u * v * p - (1 + u * u) * q + v * r, (1 + v * v) * p - u * v * q - u * r])


def _of_plane(x: Array, plane: Array) -> Array:
    """(n, 2) speed of points by the motion of a plane."""
    u, v = x.T
    a, b, c, d, e, f, g, h = plane
    fold = g * u + h * v
    return np.column_stack([a * u + b * v + c - u * fold, d * u + e * v + f - v * fold])


def _plane(corners: Array, speed: Array) -> Array:
    """(8,) the motion that gives four points (4, 2) their speeds (4, 2)."""
    columns = [_of_plane(corners, unit).ravel() for unit in np.eye(8)]
    return np.asarray(np.linalg.solve(np.column_stack(columns), speed.ravel()))
