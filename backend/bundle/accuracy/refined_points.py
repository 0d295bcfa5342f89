"""Places of the floor points of a refined map, and their standard deviations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.factors import FLOOR_Z, LOG_SCALE, SLOPE, WORLD, WORLD_SIZE
from backend.bundle.metric_poses import origin
from backend.bundle.minimise import BundleOptimum
from backend.bundle.reduced_system import columns_at_once
from backend.se3 import cross_matrix

Array = NDArray[np.float64]

_DRAWS, _AT_A_TIME = 200, 25
"""Draws of the posterior: a standard deviation of n draws is known to 1 / sqrt(2 n) of itself, 5 % here."""


def metric_points(optimum: BundleOptimum) -> Array:
    """Return (t, 3) the floor points in the measured world, in metres."""
    transform = optimum.transform
    place = transform.scale * optimum.at.point @ transform.slope.T + transform.w_T_f.translation()
    return np.asarray(place)


def metric_point_stds(optimum: BundleOptimum, seed: int = 0, draws: int = _DRAWS) -> Array:
    """Return (t, 3) the standard deviations of these along the axes of the world, in metres.

    They belong to the poses' covariances: without positions the first keyframe is the origin by definition.
    With the whitened Jacobian A and random r of unit variance, (A'A)^-1 A'r has the covariance of the
    posterior, (A'A)^-1. The scatter of such ``draws`` is therefore that of the points, the errors of poses,
    scale and slope included. ``seed`` draws them.

    Raises ``SingularMatrixError`` if a direction is open. Source: Papandreou and Yuille, "Gaussian sampling
    by local perturbations", NIPS 2010.
    """
    linear, reduced = optimum.eliminated()
    rows = len(linear.right)
    world = reduced.structure.columns(WORLD)
    of_point, of_world = point_jacobians(optimum)
    rng, squares = np.random.default_rng(seed), np.zeros((len(of_world), 3))
    at_once = columns_at_once(rows, _AT_A_TIME)
    for begin in range(0, draws, at_once):
        noise = rng.standard_normal((rows, min(at_once, draws - begin)))
        by_pose, by_point = reduced.solve(*linear.transposed_times(noise))
        moved = of_point @ by_point.reshape(len(of_world), 3, by_point.shape[1]) + of_world @ by_pose[world]
        squares += np.sum(moved**2, axis=2)
    return np.sqrt(squares / draws)


def point_jacobians(optimum: BundleOptimum) -> tuple[Array, Array]:
    """Return the Jacobians of the metric points by the points (3, 3), and by the world variable (t, 3, w).

    They are those of `backend.bundle.world.WorldTransform.jacobian` for points.
    """
    transform, away = optimum.transform, optimum.at.point - origin(optimum.problem, optimum.values)
    of_point = transform.scale * transform.slope
    of_world = np.zeros((len(away), 3, WORLD_SIZE))
    of_world[:, :, LOG_SCALE] = away @ of_point.T
    of_world[:, 2, FLOOR_Z] = 1.0
    turned = np.array([cross_matrix(p) for p in away]).reshape(-1, 3, 3) @ transform.slope_jacobian
    of_world[:, :, SLOPE] = -of_point @ turned
    return of_point, of_world
