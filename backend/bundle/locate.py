"""Places of points of the ground by the pictures of a refined map alone, without their survey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.control import in_metres, on_floor, view
from backend.bundle.exposure_motion import row_shifts
from backend.bundle.factors import WORLD
from backend.bundle.minimise import BundleOptimum
from backend.bundle.observations import Cameras
from backend.bundle.reduced_system import ReducedSystem
from backend.measurements import ControlPoint
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]

_STEPS = 20
"""Steps of Gauss and Newton: each gains digits, as rays that meet steeply make the problem nearly linear."""


@dataclass(frozen=True)
class LocatedPoint:
    """A point by its views alone."""

    w_p_m: Array
    """(3,) place in the world."""
    covariance: Array
    """(3, 3) of that place, from the noise of the views and the errors of map and lens; NaN if unknown."""
    residual_px: Array
    """(m, 2) projection minus pixel."""


def locate(optimum: BundleOptimum, points: Sequence[ControlPoint]) -> list[LocatedPoint]:
    """Return where the refined pictures show each point; each needs two views or more."""
    try:
        reduced = optimum.linearise().eliminate() if points else None
    except SingularMatrixError:
        reduced = None
    return [_located(optimum, reduced, point) for point in points]


def _located(optimum: BundleOptimum, reduced: ReducedSystem | None, point: ControlPoint) -> LocatedPoint:
    cameras, huber = Cameras.of(optimum.problem, optimum.values), optimum.problem.config.huber_sigmas
    keyframes, std_px = point.keyframe.tolist(), point.std_px * optimum.noise.marks
    place = on_floor(point, optimum.problem.camera, cameras.f_T_c)
    shifts = row_shifts(optimum.problem.exposure_motion, point.keyframe, point.pixel)
    for _ in range(_STEPS):
        views = [
            view(
                cameras.f_T_c[k],
                shift.point_at_once(place, cameras.f_T_c[k, :3, 3]),
                cameras.calibration,
                pixel,
            )
            for k, pixel, shift in zip(keyframes, point.pixel, shifts, strict=True)
        ]
        residual, by_pose, by_point, by_lens = (np.array(part) for part in zip(*views, strict=True))
        distance = np.linalg.norm(residual, axis=1) / std_px
        weight = np.minimum(huber / np.maximum(distance, huber), 1.0) / std_px**2
        weighted = by_point * weight[:, None, None]
        # A ray leaves its own direction open: two equal ones must not stop the steps.
        information = np.einsum("mai,maj->ij", weighted, by_point)
        covariance = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        step = covariance @ np.einsum("mai,ma->i", weighted, residual)
        place = place - step
        if np.linalg.norm(step) < 1e-10:
            break
    by_views = -np.einsum("ij,maj->mia", covariance, weighted)
    metric, of_point, of_world = in_metres(place, optimum.values.atVector(WORLD))
    if reduced is None:
        return LocatedPoint(metric, np.full((3, 3), np.nan), residual)
    gradient = np.zeros((reduced.size, 3))
    for k, moved, J_pose in zip(keyframes, by_views, by_pose, strict=True):
        gradient[reduced.structure.columns(POSE(k))] += (of_point @ moved @ J_pose).T
    if optimum.problem.self_calibrates:
        lens = np.einsum("mia,maj->ij", by_views, by_lens)
        gradient[reduced.structure.columns(CALIBRATION(0))] += (of_point @ lens).T
    gradient[reduced.structure.columns(WORLD)] += of_world.T
    by_map = gradient.T @ reduced.factor.solve(gradient)
    return LocatedPoint(metric, by_map + of_point @ covariance @ of_point.T, residual)
