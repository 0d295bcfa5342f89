"""Projection of floor points into pictures, with derivatives and Huber's weights: numba kernels.

The numbers of a calibration are (fx, fy, cx, cy, k1, k2, p1, p2, k3) of a pinhole with distortion, or
(fx, fy, cx, cy, k1, k2, k3, k4) of an equidistant fisheye, in OpenCV's notation: their count tells the model.
Poses are perturbed on the right, rotation first.

Source: Brown 1966 (distortion); Kannala and Brandt 2006 (fisheye); Hartley and Zisserman 2004, section 7.4;
Huber 1964.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.compilation import discard_stale, njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

discard_stale([Path(__file__)])

_EQUIDISTANT_SIZE = 8
"""Numbers of an equidistant fisheye's calibration."""
_ON_AXIS = 1e-8
"""Squared image radius below which the radius of a fisheye is its series at the axis: the next term is then
below the rounding."""


@njit(cache=True)
def in_camera(f_T_c: Array, point: Array) -> tuple[float, float, float]:
    """Return the coordinates of a point in the camera."""
    x, y, z = point[0] - f_T_c[0, 3], point[1] - f_T_c[1, 3], point[2] - f_T_c[2, 3]
    return (
        f_T_c[0, 0] * x + f_T_c[1, 0] * y + f_T_c[2, 0] * z,
        f_T_c[0, 1] * x + f_T_c[1, 1] * y + f_T_c[2, 1] * z,
        f_T_c[0, 2] * x + f_T_c[1, 2] * y + f_T_c[2, 2] * z,
    )


@njit(cache=True)
def _distorted(calibration: Array, x: float, y: float) -> tuple[float, float]:
    """Return image coordinates over the focal length with the distortion of the lens."""
    if len(calibration) == _EQUIDISTANT_SIZE:
        stretch, _ = _equidistant(calibration, x * x + y * y)
        return stretch * x, stretch * y
    k1, k2, p1, p2, k3 = calibration[4:]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        radial * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        radial * y + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
    )


@njit(cache=True)
def _equidistant(calibration: Array, r2: float) -> tuple[float, float]:
    """Return the recorded over the undistorted radius r of a fisheye, and its derivative by r, over r."""
    k1, k2, k3, k4 = calibration[4:]
    if r2 < _ON_AXIS:
        return 1.0 + (k1 - 1.0 / 3.0) * r2, 2.0 * (k1 - 1.0 / 3.0)
    r = math.sqrt(r2)
    angle = math.atan(r)
    a2 = angle * angle
    stretch = angle / r * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
    return stretch, (slope / (1.0 + r2) - stretch) / r2


@njit(cache=True)
def distorted(calibration: Array, xy: Array) -> Array:
    """Return recorded pixels (m, 2) of undistorted image coordinates (m, 2) over the focal length."""
    fx, fy, cx, cy = calibration[:4]
    pixel = np.empty((len(xy), 2))
    for m in range(len(xy)):
        xd, yd = _distorted(calibration, xy[m, 0], xy[m, 1])
        pixel[m, 0], pixel[m, 1] = fx * xd + cx, fy * yd + cy
    return pixel


@njit(cache=True)
def residual(f_T_c: Array, point: Array, calibration: Array, pixel: Array) -> tuple[float, float]:
    """Return projection minus measured pixel: twice the focal length for a point behind the camera."""
    x, y, z = in_camera(f_T_c, point)
    fx, fy, cx, cy = calibration[:4]
    if z <= 0.0:
        return 2.0 * fx, 2.0 * fx
    xd, yd = _distorted(calibration, x / z, y / z)
    return fx * xd + cx - pixel[0], fy * yd + cy - pixel[1]


@njit(cache=True)
def residuals(
    f_T_c: Array, point: Array, calibration: Array, keyframe: Index, track: Index, pixel: Array
) -> Array:
    """Return projection minus pixel (m, 2) of all observations."""
    found = np.empty((len(keyframe), 2))
    for m in range(len(keyframe)):
        found[m, 0], found[m, 1] = residual(f_T_c[keyframe[m]], point[track[m]], calibration, pixel[m])
    return found


@njit(cache=True)
def linearise(
    f_T_c: Array,
    point: Array,
    calibration: Array,
    keyframe: Index,
    track: Index,
    pixel: Array,
    std_px: Array,
    huber_sigmas: float,
    of_pose: Array,
    of_point: Array,
    of_calibration: Array,
) -> Array:
    """Return minus the whitened residuals (m, 2), and fill in their Jacobians.

    The Jacobians are ``of_pose`` (m, 2, 6), ``of_point`` (m, 2, 3) and ``of_calibration`` (m, 2, q), q = 0
    for a fixed calibration. Rows beyond Huber's limit have the square root of its weight. A point
    behind the camera has no derivatives.
    """
    count, lens = len(keyframe), of_calibration.shape[2] > 0
    right = np.empty((count, 2))
    of_ray, of_place = np.zeros((2, 2)), np.zeros((2, 3))
    for m in range(count):
        T = f_T_c[keyframe[m]]
        u, v = residual(T, point[track[m]], calibration, pixel[m])
        distance = math.sqrt(u * u + v * v) / std_px[m]
        weight = 1.0 / std_px[m]
        if distance > huber_sigmas:
            weight *= math.sqrt(huber_sigmas / distance)
        right[m, 0], right[m, 1] = -weight * u, -weight * v
        X, Y, Z = in_camera(T, point[track[m]])
        if Z <= 0.0:
            of_pose[m], of_point[m], of_calibration[m] = 0.0, 0.0, 0.0
            continue
        by_place(calibration, X, Y, Z, weight, of_ray, of_place)
        for row in range(2):
            a, b, c = of_place[row]
            J = of_pose[m, row]
            J[0], J[1], J[2] = b * Z - c * Y, c * X - a * Z, a * Y - b * X
            J[3], J[4], J[5] = -a, -b, -c
            for axis in range(3):
                of_point[m, row, axis] = a * T[axis, 0] + b * T[axis, 1] + c * T[axis, 2]
        if lens:
            _by_calibration(calibration, X / Z, Y / Z, weight, of_calibration[m])
    return right


@njit(cache=True)
def by_place(
    calibration: Array, X: float, Y: float, Z: float, weight: float, of_ray: Array, J: Array
) -> None:
    """Fill in the Jacobian (2, 3) of the pixel by the place in the camera, times a weight, and ``of_ray``."""
    x, y = X / Z, Y / Z
    _by_ray(calibration, x, y, of_ray)
    for row in range(2):
        a, b = weight * of_ray[row, 0] / Z, weight * of_ray[row, 1] / Z
        J[row, 0], J[row, 1], J[row, 2] = a, b, -(a * x + b * y)


@njit(cache=True)
def _by_ray(calibration: Array, x: float, y: float, J: Array) -> None:
    """Fill in the Jacobian (2, 2) of the pixel by the undistorted image coordinates."""
    fx, fy = calibration[:2]
    r2 = x * x + y * y
    if len(calibration) == _EQUIDISTANT_SIZE:
        radial, growth = _equidistant(calibration, r2)
        J[0, 0], J[0, 1] = fx * (radial + growth * x * x), fx * growth * x * y
        J[1, 0], J[1, 1] = fy * growth * x * y, fy * (radial + growth * y * y)
        return
    k1, k2, p1, p2, k3 = calibration[4:]
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    growth = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
    xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + growth * y * y + 2.0 * p2 * x + 6.0 * p1 * y
    xy = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    J[0, 0], J[0, 1] = fx * xx, fx * xy
    J[1, 0], J[1, 1] = fy * xy, fy * yy


@njit(cache=True)
def _by_calibration(calibration: Array, x: float, y: float, weight: float, J: Array) -> None:
    """Fill in the Jacobian (2, q) of the pixel by the calibration, times the weight."""
    fx, fy = calibration[:2]
    xd, yd = _distorted(calibration, x, y)
    r2 = x * x + y * y
    J[:] = 0.0
    J[0, 0], J[0, 2] = weight * xd, weight
    J[1, 1], J[1, 3] = weight * yd, weight
    if len(calibration) == _EQUIDISTANT_SIZE:
        angle = math.atan(math.sqrt(r2))
        power = 1.0 if r2 < _ON_AXIS else angle / math.sqrt(r2)
        for k in range(4):
            power *= angle * angle
            J[0, 4 + k] = weight * fx * power * x
            J[1, 4 + k] = weight * fy * power * y
        return
    terms = (
        (x * r2, y * r2),
        (x * r2 * r2, y * r2 * r2),
        (2.0 * x * y, r2 + 2.0 * y * y),
        (r2 + 2.0 * x * x, 2.0 * x * y),
        (x * r2 * r2 * r2, y * r2 * r2 * r2),
    )
    for k in range(5):
        J[0, 4 + k] = weight * fx * terms[k][0]
        J[1, 4 + k] = weight * fy * terms[k][1]


_UNDISTORTION_STEPS = 20
"""Newton steps from the recorded place: quadratic, so that few are needed where the lens does not fold."""


@njit(cache=True)
def undistorted(calibration: Array, pixel: Array) -> Array:
    """Return image coordinates (m, 2) over the focal length, without distortion, of pixels (m, 2).

    Where the distortion folds the picture, so that no step improves, the recorded place is returned.
    """
    fx, fy, cx, cy = calibration[:4]
    found, J = np.empty((len(pixel), 2)), np.empty((2, 2))
    for m in range(len(pixel)):
        xr, yr = (pixel[m, 0] - cx) / fx, (pixel[m, 1] - cy) / fy
        x, y = xr, yr
        for _ in range(_UNDISTORTION_STEPS):
            xd, yd = _distorted(calibration, x, y)
            _by_ray(calibration, x, y, J)
            a, b, c, d = J[0, 0] / fx, J[0, 1] / fx, J[1, 0] / fy, J[1, 1] / fy
            determinant = a * d - b * c
            if determinant <= 0.0:
                x, y = xr, yr
                break
            dx, dy = xd - xr, yd - yr
            step_x, step_y = (d * dx - b * dy) / determinant, (a * dy - c * dx) / determinant
            x, y = x - step_x, y - step_y
            if abs(step_x) + abs(step_y) < 1e-12:
                break
        found[m, 0], found[m, 1] = x, y
    return found
