"""Camera with a distorting lens, looking at a floor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

from backend.measurements import LensModel

Array = NDArray[np.float64]

NADIR_B_T_C: Array = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
"""Mount of a down-looking camera at the body origin. The nose points to the top of the picture."""

_MIN_AREA_RATIO = 0.01
"""Lower limit of the area ratio. Smaller values occur where the distortion polynomial is not monotonic."""

_MAX_ANGLE_RAD = np.radians(80.0)
"""Largest angle from the axis of a fisheye's ray: at it an undistorted pixel is 33 times as long."""
_ANGLES, _NEWTON_STEPS = 1000, 2
"""Angles of the table that starts the inversion of a fisheye, 1.4 mrad apart. Each step of Newton squares the
error of the start, which is below 1e-6."""


class Intrinsics(NamedTuple):
    """The numbers that decide at which pixel a ray is recorded; as a whole they can be a key."""

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    size_px: tuple[int, int]
    distortion: tuple[float, ...]
    lens: LensModel

    def camera(self) -> Camera:
        """Return a camera with these numbers, which are exact, and the usual mount."""
        return Camera(**self._asdict())


@dataclass(frozen=True)
class Camera:
    """Intrinsics and mount of one camera; pixel (0, 0) is the centre of the first pixel."""

    focal_px: tuple[float, float]
    center_px: tuple[float, float]
    size_px: tuple[int, int]
    """(width, height)."""
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    """OpenCV's (k1, k2, p1, p2[, k3]), or (k1, k2, k3, k4) of an equidistant fisheye."""
    b_T_c: Array = field(default_factory=lambda: NADIR_B_T_C.copy())
    """(4, 4) transform from camera to body coordinates."""
    focal_std_ratio: float = 0.0
    """Relative standard deviation of the focal length. Numbers whose deviation is above 0 are estimated."""
    aspect_std_ratio: float = 0.0
    """Relative standard deviation of either focal length about what both have in common."""
    center_std_px: float = 0.0
    """Standard deviation of the principal point along either axis."""
    radial_std: float = 0.0
    """Standard deviation of k1, k2, k3 and k4."""
    tangential_std: float = 0.0
    """Standard deviation of p1 and p2."""
    mount_std_rad: float | None = None
    """Standard deviation of the tilt of the mount, which is estimated above 0. None where nothing is told of
    it, and 0 where it is exact: it is fixed in both."""
    readout_s: float = 0.0
    """Readout time. Row i of n is exposed readout_s i / (n - 1) after the stamp; 0 for a global shutter."""
    stated_readout_s: float | None = None
    """The stated readout time where ``readout_s`` is an estimate, 0 if none is stated; else None."""
    lens: LensModel = "brown"
    stated: Camera | None = None
    """The camera with the stated lens, where this one is an estimate: the deviations are about it."""

    @property
    def has_free_mount(self) -> bool:
        """Whether the tilt of the mount is estimated."""
        return bool(self.mount_std_rad)

    @property
    def intrinsics(self) -> Intrinsics:
        """All numbers of the lens and the size of the pictures."""
        return Intrinsics(self.focal_px, self.center_px, self.size_px, self.distortion, self.lens)

    @property
    def matrix(self) -> Array:
        """Intrinsic matrix K (3, 3)."""
        (fu, fv), (cu, cv) = self.focal_px, self.center_px
        return np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1.0]])

    def narrowed(self, width_px: int) -> Camera:
        """Return the camera of the pictures reduced to at most ``width_px`` (`cv2.resize`)."""
        ratio = min(1.0, width_px / self.size_px[0])
        width, height = (max(2, round(ratio * side)) for side in self.size_px)
        x, y = width / self.size_px[0], height / self.size_px[1]
        return replace(
            self,
            focal_px=(x * self.focal_px[0], y * self.focal_px[1]),
            center_px=(x * (self.center_px[0] + 0.5) - 0.5, y * (self.center_px[1] + 0.5) - 0.5),
            size_px=(width, height),
            center_std_px=ratio * self.center_std_px,
        )

    @property
    def is_distorted(self) -> bool:
        """Whether the pictures differ from those of an ideal pinhole."""
        return self.lens == "equidistant" or any(self.distortion)

    @property
    def all_distortion(self) -> tuple[float, ...]:
        """The coefficients, with a k3 in Brown's model."""
        return self.distortion if self.lens == "equidistant" else (*self.distortion, 0.0)[:5]

    @property
    def stated_numbers(self) -> tuple[float, ...]:
        """(fx, fy, cx, cy) and coefficients that were stated; a lens of another model had none."""
        stated = self.stated or self
        terms = stated.all_distortion if stated.lens == self.lens else (0.0,) * len(self.all_distortion)
        return (*stated.focal_px, *stated.center_px, *terms)

    @property
    def corners_px(self) -> Array:
        """(4, 2) centres of the corner pixels, clockwise from the top left."""
        w, h = self.size_px
        return np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], dtype=float)

    def undistort(self, pixel: Array) -> Array:
        """Return the pixels (n, 2) that an ideal pinhole with the same K records for pixels (n, 2)."""
        pixel = np.asarray(pixel, dtype=float).reshape(-1, 2)
        if not self.is_distorted or len(pixel) == 0:
            return pixel
        if self.lens == "equidistant":
            return self._undistort_fisheye(pixel)
        # OpenCV's default of five iterations leaves 0.15 px in the corners of a wide lens.
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-6)
        lens, K = np.array(self.distortion), self.matrix
        return np.asarray(cv2.undistortPoints(pixel[:, None], K, lens, P=K, criteria=stop).reshape(-1, 2))

    def _undistort_fisheye(self, pixel: Array) -> Array:
        """Return undistorted pixels (n, 2); those of larger angles than can be undistorted at the largest."""
        powers = np.array([1.0, *self.distortion])
        grid = np.linspace(0.0, _MAX_ANGLE_RAD, _ANGLES)
        radius = grid * polyval(grid**2, powers)
        folds = np.flatnonzero(np.diff(radius) <= 0)
        known = slice(None, folds[0] + 1 if len(folds) else None)
        from_center = (pixel - self.center_px) / self.focal_px
        recorded = np.linalg.norm(from_center, axis=1)
        angle = np.interp(recorded, radius[known], grid[known])
        inside = recorded < radius[known][-1]
        for _ in range(_NEWTON_STEPS):
            off = angle * polyval(angle**2, powers) - recorded
            slope = polyval(angle**2, powers * np.arange(1, 10, 2))
            angle = np.where(inside & (slope > 0), angle - off / np.where(slope > 0, slope, 1.0), angle)
        stretch = np.divide(np.tan(angle), recorded, out=np.ones(len(pixel)), where=recorded > 0)
        return np.asarray(from_center * stretch[:, None] * self.focal_px + self.center_px)

    def recorded(self, pixel: Array) -> Array:
        """Return the distorted pixels (n, 2) of **undistorted** pixels (n, 2)."""
        return self.project(self.rays(pixel)) if self.is_distorted else np.asarray(pixel, dtype=float)

    def magnification(self, pixel: Array) -> Array:
        """Return (n,) the side of a recorded pixel in undistorted pixels at **undistorted** pixels (n, 2).

        Position errors arise in recorded pixels; undistortion multiplies them by this factor.
        """
        pixel = np.asarray(pixel, dtype=float).reshape(-1, 2)
        if not self.is_distorted or len(pixel) == 0:
            return np.ones(len(pixel))
        right, down = (
            self.project(self.rays(pixel + step)) - self.project(self.rays(pixel - step))
            for step in 0.5 * np.eye(2)
        )
        area = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
        return np.asarray(1 / np.sqrt(np.maximum(area, _MIN_AREA_RATIO)))

    def rays(self, pixel: Array) -> Array:
        """Return directions (n, 3) in camera axes, with z = 1, of **undistorted** pixels (n, 2)."""
        pixel = np.asarray(pixel, dtype=float).reshape(-1, 2)
        xy = (pixel - self.center_px) / self.focal_px
        return np.column_stack([xy, np.ones(len(xy))])

    def project(self, c_p: Array) -> Array:
        """Return distorted pixels (n, 2) of points (n, 3) in camera coordinates; NaN behind the camera."""
        c_p = np.asarray(c_p, dtype=float).reshape(-1, 3)
        pixel = np.full((len(c_p), 2), np.nan)
        front = c_p[:, 2] > 1e-9
        if front.any():
            project = cv2.fisheye.projectPoints if self.lens == "equidistant" else cv2.projectPoints
            pixel[front] = project(
                c_p[front, None], np.zeros(3), np.zeros(3), self.matrix, np.array(self.distortion)
            )[0].reshape(-1, 2)
        return pixel

    def recorded_maps(
        self, node_H_ray: Array, size_px: tuple[int, int], matrix: Array | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the recorded pixel (u, v), each (h, w), of the nodes of a grid of ``size_px`` (w, h).

        ``node_H_ray`` (3, 3) maps rays in camera axes to nodes. ``matrix`` (3, 3) is that of a picture of
        another size, and the camera's own where it is missing.
        """
        init = cv2.fisheye if self.lens == "equidistant" else cv2
        # OpenCV inverts its "new camera matrix" to map a node to a ray, and accepts any homography.
        u, v = init.initUndistortRectifyMap(
            self.matrix if matrix is None else matrix,
            np.array(self.distortion),
            np.eye(3),
            node_H_ray,
            size_px,
            cv2.CV_32FC1,
        )
        return u, v

    def floor_H_image(self, w_T_b: Array, floor_z: float = 0.0) -> Array:
        """Return the homography (3, 3) from undistorted pixels to world (x, y) on the plane z = floor_z.

        Source: IMAV 2011 paper, section 3.1 (the map is a plane); Hartley and Zisserman 2004, section 8.1.
        """
        w_T_c = w_T_b @ self.b_T_c
        R, t = w_T_c[:3, :3], w_T_c[:3, 3]
        image_H_floor = (
            self.matrix @ R.T @ np.column_stack([[1.0, 0, 0], [0, 1.0, 0], np.array([0, 0, floor_z]) - t])
        )
        return np.linalg.inv(image_H_floor)

    def floor_points(self, w_T_b: Array, pixel: Array, floor_z: float = 0.0) -> Array:
        """Return world (x, y) where the rays of undistorted pixels hit the floor; NaN above the horizon."""
        w_T_c = w_T_b @ self.b_T_c
        direction = self.rays(pixel) @ w_T_c[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (floor_z - w_T_c[2, 3]) / direction[:, 2]
        s = np.where(s > 0, s, np.nan)
        return w_T_c[:2, 3] + s[:, None] * direction[:, :2]

    def footprint(self, w_T_b: Array, floor_z: float = 0.0) -> Array:
        """Return the world corners (4, 2) of the visible floor."""
        return self.floor_points(w_T_b, self.undistort(self.corners_px), floor_z)
