"""How accurately the pictures of a refined map place the ground: poses and lens together.

A wrong lens turns the rays of a picture. Where positions hold the cameras, a focal length that is 1 % too
long puts the floor 1 % too far below them, and the ground stays where it is: both errors cancel. The
covariance of a pose alone does not know this. An error of the lens moves the ground that a picture shows
almost as a motion of the camera would. The motion that does it best is therefore added to the errors of the
pose, with which the lens is correlated.

Source: derived.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import WORLD
from backend.bundle.metric_poses import over_floor_jacobians, propagated
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.projections import undistorted
from backend.se3 import cross_matrix

Array = NDArray[np.float64]

_RAYS = 5
"""Rays along each side of the picture on which lens and motion are compared: more than the six numbers of a
motion, and both ends and the middle of the highest power of a lens."""
INNER_RAYS = tuple(row * _RAYS + column for row in range(1, _RAYS - 1) for column in range(1, _RAYS - 1))
"""Those in the middle of a picture, of which a mosaic is made; pictures overlap elsewhere."""
_STEP = 1e-6
"""Relative step of the central differences, the cube root of the rounding at most."""


def ground_covariances(optimum: BundleOptimum) -> Array:
    """Return (n, 6, 6) covariances with which each keyframe places the floor that its picture shows.

    They are those of the metric body poses over the floor, rotation first, right perturbation, with the
    errors of the lens as equal motions of the body.

    Raises ``SingularMatrixError`` if a direction is open.
    """
    problem = optimum.problem
    reduced = optimum.linearise().eliminate()
    poses = [POSE(k) for k in range(problem.measurements.count)]
    lens = (CALIBRATION(0),) if problem.self_calibrates else ()
    return propagated(ground_jacobians(optimum), reduced.joint_covariances(poses, WORLD, *lens))


def ground_jacobians(optimum: BundleOptimum) -> Array:
    """Return the Jacobians (n, 6, 6 + w) of metric body poses over the floor, rotation first, right
    perturbation, by perturbations of pose and world; (n, 6, 6 + w + q) with those of an estimated lens."""
    J = over_floor_jacobians(optimum.problem, optimum.values)
    if not optimum.problem.self_calibrates:
        return J
    cameras = Cameras.of(optimum.problem, optimum.values)
    ray, of_lens = _rays(cameras.calibration, _seen_pixel(optimum))
    to_body = _to_body(optimum)
    of_lens = np.array([to_body @ _equal_motion(f_T_c, ray, of_lens) for f_T_c in cameras.f_T_c])
    return np.concatenate([J, of_lens], axis=2)


@dataclass(frozen=True)
class SeenGround:
    """Places of the ground that the pictures of a map show, on a grid over the observed part of each."""

    f_T_c: Array
    """(n, 4, 4) poses of the cameras over the level floor, in mean heights."""
    ray: Array
    """(m, 3) directions of the places at depth 1."""
    to_body: Array
    """(6, 6) right perturbation of a metric body pose by that of its camera in mean heights."""
    height_m: float
    """Length of a mean height."""

    @staticmethod
    def of(optimum: BundleOptimum) -> SeenGround:
        """Return the places of a refined map."""
        cameras = Cameras.of(optimum.problem, optimum.values)
        ray, _ = _rays(cameras.calibration, _seen_pixel(optimum))
        height_m = optimum.transform.scale
        return SeenGround(cameras.f_T_c, ray, _to_body(optimum), height_m)

    def jacobian(self, k: int) -> Array:
        """Return the Jacobian (2m, 6) of the ground at the places in the picture of keyframe k, x and y in
        mean heights, by the right perturbation of the metric body pose."""
        of_camera = _of_pose(*_ends(self.f_T_c[k], self.ray), self.ray)
        return np.asarray(np.linalg.solve(self.to_body.T, of_camera.T).T)

    def place_m(self, k: int) -> Array:
        """Return x and y (m, 2) of the places in the picture of keyframe k, in metres."""
        _, length = _ends(self.f_T_c[k], self.ray)
        place = self.f_T_c[k, :3, 3] + length[:, 0] * (self.ray @ self.f_T_c[k, :3, :3].T)
        return self.height_m * place[:, :2]


def _to_body(optimum: BundleOptimum) -> Array:
    """Return (6, 6) the right perturbation of a metric body pose by that of its camera in mean heights."""
    transform = optimum.transform
    return np.asarray(transform.adjoint @ np.diag([1.0, 1.0, 1.0, *(transform.scale,) * 3]))


def _seen_pixel(optimum: BundleOptimum) -> Array:
    """Return pixels (m, 2) at which the ground was observed: points, or corners of aligned pictures."""
    seen = optimum.cost.observations.pixel
    aligned = [pair.pixel for pair in optimum.problem.measurements.aligned]
    return seen if len(seen) or not aligned else np.concatenate(aligned)


def _rays(calibration: Array, pixel: Array) -> tuple[Array, Array]:
    """Return directions (m, 3) at depth 1 over the observed part of the picture, and their derivatives
    (m, 3, q) by the numbers of the lens at fixed pixels."""
    sides = np.linspace(pixel.min(axis=0), pixel.max(axis=0), _RAYS)
    grid = np.stack(np.meshgrid(*sides.T), axis=-1).reshape(-1, 2)
    ray = np.column_stack([undistorted(calibration, grid), np.ones(len(grid))])
    of_lens = np.zeros((*ray.shape, len(calibration)))
    for number, value in enumerate(calibration):
        step = np.zeros(len(calibration))
        step[number] = _STEP * max(abs(value), 1.0)
        ends = [undistorted(calibration + sign * step, grid) for sign in (1.0, -1.0)]
        of_lens[:, :2, number] = (ends[0] - ends[1]) / (2.0 * step[number])
    return ray, of_lens


def _equal_motion(f_T_c: Array, ray: Array, of_lens: Array) -> Array:
    """Return (6, q) the right perturbations of a camera (4, 4), in mean heights, that move the floor at the
    ends of its rays as the lens does, in least squares."""
    of_end, length = _ends(f_T_c, ray)
    of_pose = _of_pose(of_end, length, ray)
    by_lens = (of_end @ (length * of_lens)).reshape(len(of_pose), -1)
    return np.asarray(np.linalg.lstsq(of_pose, by_lens, rcond=None)[0])


def _ends(f_T_c: Array, ray: Array) -> tuple[Array, Array]:
    """Return the Jacobians (m, 2, 3) of the floor at the ends of rays (m, 3) of a camera (4, 4) by motions of
    these ends in camera axes, and the lengths (m, 1, 1) of the rays."""
    R, height = f_T_c[:3, :3], f_T_c[2, 3]
    direction = ray @ R.T
    # What moves the end of a ray moves the floor there after a slide along the ray, back to the floor.
    slide = np.zeros((len(ray), 2, 3))
    slide[:, 0, 0] = slide[:, 1, 1] = 1.0
    slide[:, :, 2] = -direction[:, :2] / direction[:, 2:]
    return slide @ R, (-height / direction[:, 2])[:, None, None]


def _of_pose(of_end: Array, length: Array, ray: Array) -> Array:
    """Return the Jacobian (2m, 6) of the floor at the ends by the right perturbation of the camera."""
    turned = np.array([-cross_matrix(each) for each in ray])
    return np.concatenate([of_end @ (length * turned), of_end], axis=2).reshape(-1, 6)
