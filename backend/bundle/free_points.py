"""Places of floor points by their pictures alone, with the cameras fixed: numba kernels.

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

from backend.bundle import projections, schur
from backend.bundle.observations import Cameras, FloorObservations
from backend.bundle.projections import by_place, in_camera, residual
from backend.bundle.schur import inverse_cholesky
from backend.compilation import discard_stale, njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

discard_stale([Path(__file__), Path(projections.__file__), Path(schur.__file__)])

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

    @property
    def variance(self) -> Array:
        """(t,) of each height by the pictures alone."""
        return np.asarray(1.0 / np.maximum(self.information, np.finfo(float).tiny))

    @property
    def height(self) -> Array:
        """(t,) heights by the pictures alone: those of the points are drawn to zero by the fit's prior."""
        return np.asarray(self.point[:, 2] * (1.0 + _HEIGHT_INFORMATION * self.variance))

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
    V, R, g, used = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.ones(len(keyframe), np.bool_)
    of_ray, of_place = np.zeros((2, 2)), np.zeros((2, 3))
    for t in range(len(start)):
        begin, end = first[t], first[t + 1]
        count = end - begin
        while count >= 2:
            p, ahead = point[t], True
            for _ in range(_STEPS):
                ahead = _add_up(
                    f_T_c, p, calibration, keyframe, pixel, std_px, huber_sigmas, used, begin, end,
                    of_ray, of_place, V, g,
                )  # fmt: skip
                if not ahead:
                    break
                inverse_cholesky(V, R)
                if _step(R, g, p) < _STEP:
                    break
            if not ahead:
                point[t], information[t], count = start[t], 0.0, 0
                break
            # The last number of the factor is what remains of the height's with x and y marginalised.
            information[t] = max(1.0 / (R[2, 2] * R[2, 2]) - _HEIGHT_INFORMATION, 0.0)
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
    of_place: Array,
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
        by_place(calibration, X, Y, Z, 1.0, of_ray, of_place)
        for row in range(2):
            a, b, c = of_place[row]
            off = u if row == 0 else v
            for i in range(3):
                of_i = a * T[i, 0] + b * T[i, 1] + c * T[i, 2]
                g[i] -= weight * of_i * off
                for j in range(i + 1):
                    V[i, j] += weight * of_i * (a * T[j, 0] + b * T[j, 1] + c * T[j, 2])
    return True


@njit(cache=True)
def _step(R: Array, g: Array, p: Array) -> float:
    """Add V^-1 g = R' R g to the point; return the largest change."""
    a = R[0, 0] * g[0]
    b = R[1, 0] * g[0] + R[1, 1] * g[1]
    c = R[2, 0] * g[0] + R[2, 1] * g[1] + R[2, 2] * g[2]
    x, y, z = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c, R[1, 1] * b + R[2, 1] * c, R[2, 2] * c
    p[0] += x
    p[1] += y
    p[2] += z
    return float(max(abs(x), abs(y), abs(z)))
