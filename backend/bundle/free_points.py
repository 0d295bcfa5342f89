"""Places of floor points by their pictures alone, with the cameras held: numba kernels.

A point that moved, or that was matched wrongly, has no place that all its pictures agree on. Its worst
observations are left out one by one, until the others agree.

Source: Hartley and Sturm 1997 (triangulation as a minimisation in the pictures); Huber 1964.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.bundle import projections
from backend.bundle.observations import Cameras, FloorObservations
from backend.bundle.projections import by_ray, in_camera, residual
from backend.compilation import discard_stale, njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

discard_stale([Path(__file__), Path(projections.__file__)])

_STEPS, _STEP = 10, 1e-6
"""Most steps of Gauss and Newton, and the length at which they end, in mean heights: far below the relief of
any floor. They start at the refined point, and most points need three."""
_PLANE_INFORMATION = 1e-8
"""Information on a place along the floor that no picture gives: as good as none."""
_HEIGHT_INFORMATION = 1.0
"""The same on the height: what stands on the ground is lower than the camera flies."""


@dataclass(frozen=True)
class FreePoints:
    """Floor points by their pictures alone."""

    point: Array
    """(t, 3) in mean heights."""
    information: Array
    """(t,) of the pictures on each point's height, with its x and y marginalised."""
    pictures: Index
    """(t,) number of observations of each."""
    agreeing: Index
    """(t,) number of those that agree on it."""

    @staticmethod
    def of(seen: FloorObservations, cameras: Cameras, point: Array, limit: float) -> FreePoints:
        """Fit the points (t, 3), without the observations farther off than ``limit`` standard deviations."""
        point, information, agreeing = fit_points(
            cameras.f_T_c, point, cameras.calibration, seen.keyframe, seen.first, seen.pixel,
            seen.std_px, seen.huber_sigmas, limit,
        )  # fmt: skip
        return FreePoints(point, information, np.diff(seen.first), agreeing)


@njit(cache=True)
def fit_points(
    f_T_c: Array,
    start: Array,
    calibration: Array,
    keyframe: Index,
    first: Index,
    pixel: Array,
    std_px: Array,
    huber_sigmas: float,
    limit: float,
) -> tuple[Array, Array, Index]:
    """Return the points (t, 3), the information on their heights (t,), and how many observations agree (t,).

    A point that comes to lie behind a camera stays at its start, and none agrees.
    """
    point, information, agreeing = start.copy(), np.zeros(len(start)), np.zeros(len(start), np.int64)
    V, g, of_ray, used = np.empty((3, 3)), np.empty(3), np.zeros((2, 2)), np.ones(len(keyframe), np.bool_)
    for t in range(len(start)):
        begin, end = first[t], first[t + 1]
        count = end - begin
        while count >= 2:
            p, ahead = point[t], True
            for _ in range(_STEPS):
                ahead = _add_up(
                    f_T_c,
                    p,
                    calibration,
                    keyframe,
                    pixel,
                    std_px,
                    huber_sigmas,
                    used,
                    begin,
                    end,
                    of_ray,
                    V,
                    g,
                )
                if not ahead or _step(V, g, p) < _STEP:
                    break
            if not ahead:
                point[t], information[t], count = start[t], 0.0, 0
                break
            plane = V[0, 0] * V[1, 1] - V[1, 0] * V[1, 0]
            information[t] = max(_determinant(V) / plane - _HEIGHT_INFORMATION, 0.0)
            worst, far = begin, 0.0
            for m in range(begin, end):
                if used[m]:
                    u, v = residual(f_T_c[keyframe[m]], p, calibration, pixel[m])
                    distance = math.sqrt(u * u + v * v) / std_px[m]
                    if distance > far:
                        worst, far = m, distance
            if far <= limit:
                break
            used[worst] = False
            count -= 1
        agreeing[t] = count
    return point, information, agreeing


@njit(cache=True)
def _add_up(
    f_T_c: Array,
    p: Array,
    calibration: Array,
    keyframe: Index,
    pixel: Array,
    std_px: Array,
    huber_sigmas: float,
    used: NDArray[np.bool_],
    begin: int,
    end: int,
    of_ray: Array,
    V: Array,
    g: Array,
) -> bool:
    """Fill in the normal equations V x = g of a point, lower triangle; return whether all cameras see it."""
    V[:], g[:] = 0.0, 0.0
    V[0, 0] = V[1, 1] = _PLANE_INFORMATION
    V[2, 2], g[2] = _HEIGHT_INFORMATION, -_HEIGHT_INFORMATION * p[2]
    for m in range(begin, end):
        if not used[m]:
            continue
        T = f_T_c[keyframe[m]]
        X, Y, Z = in_camera(T, p)
        if Z <= 0.0:
            return False
        u, v = residual(T, p, calibration, pixel[m])
        distance = math.sqrt(u * u + v * v) / std_px[m]
        weight = min(1.0, huber_sigmas / max(distance, huber_sigmas)) / (std_px[m] * std_px[m])
        x, y = X / Z, Y / Z
        by_ray(calibration, x, y, of_ray)
        for row in range(2):
            a, b = of_ray[row, 0] / Z, of_ray[row, 1] / Z
            c = -(a * x + b * y)
            off = u if row == 0 else v
            for i in range(3):
                of_i = a * T[i, 0] + b * T[i, 1] + c * T[i, 2]
                g[i] -= weight * of_i * off
                for j in range(i + 1):
                    V[i, j] += weight * of_i * (a * T[j, 0] + b * T[j, 1] + c * T[j, 2])
    return True


@njit(cache=True)
def _determinant(V: Array) -> float:
    """Return the determinant of a symmetric matrix (3, 3), whose lower triangle is read."""
    a, b, c, d, e, f = V[0, 0], V[1, 0], V[1, 1], V[2, 0], V[2, 1], V[2, 2]
    return float(a * (c * f - e * e) - b * (b * f - d * e) + d * (b * e - c * d))


@njit(cache=True)
def _step(V: Array, g: Array, p: Array) -> float:
    """Add V^-1 g to the point; return the largest change."""
    a, b, c, d, e, f = V[0, 0], V[1, 0], V[1, 1], V[2, 0], V[2, 1], V[2, 2]
    l00 = math.sqrt(a)
    l10, l20 = b / l00, d / l00
    l11 = math.sqrt(c - l10 * l10)
    l21 = (e - l20 * l10) / l11
    l22 = math.sqrt(f - l20 * l20 - l21 * l21)
    y0 = g[0] / l00
    y1 = (g[1] - l10 * y0) / l11
    y2 = (g[2] - l20 * y0 - l21 * y1) / l22
    z = y2 / l22
    y = (y1 - l21 * z) / l11
    x = (y0 - l10 * y - l20 * z) / l00
    p[0] += x
    p[1] += y
    p[2] += z
    return float(max(abs(x), abs(y), abs(z)))
