"""How accurately a refined map knows its lengths, and where it lies as a whole.

A length on the ground is no single variable. The scale of the world variable is that of the camera's height
over the floor. Where positions hold the cameras, a wrong focal length makes that height wrong, and no length.
The size of the ground is therefore that of its points: the root of their mean squared distance from their
middle, on the horizontal plane. Each point counts as often as pictures see it.

Source: derived.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.accuracy.refined_points import metric_points, point_jacobians
from backend.bundle.factors import WORLD
from backend.bundle.metric_poses import metric_jacobians, metric_poses
from backend.bundle.minimise import BundleOptimum
from backend.bundle.reduced_system import ReducedSystem

Array = NDArray[np.float64]

_LEAST_VIEWS = 2
"""Views without which a point has no place."""


@dataclass(frozen=True)
class GroundSize:
    """Uncertainty that all lengths on the ground share, and all places."""

    log_std: float
    """Standard deviation of the logarithm of the size of the ground."""
    middle_std_m: float
    """Standard deviation of the place of its middle, x and y together."""


def ground_size(optimum: BundleOptimum, reduced: ReducedSystem) -> GroundSize:
    """Return the uncertainty of the size and of the middle of the ground of an eliminated system."""
    of_pose, of_point = gradients(optimum, reduced)
    by_pose, by_point = reduced.solve(of_pose, of_point)
    variance = np.sum(of_pose * by_pose, axis=0) + np.sum(of_point * by_point, axis=0)
    return GroundSize(float(np.sqrt(variance[0])), float(np.sqrt(variance[1] + variance[2])))


def gradients(optimum: BundleOptimum, reduced: ReducedSystem) -> tuple[Array, Array]:
    """Return the derivatives (size, 3) by the pose side, and (3t, 3) by the points, of three quantities: the
    logarithm of the size of the ground, and x and y of its middle.

    Without points the positions of the keyframes stand for the ground.
    """
    if len(optimum.at.point) == 0:
        return _of_path(optimum, reduced), np.zeros((0, 3))
    place, track = metric_points(optimum), optimum.cost.observations.track
    views = np.bincount(track, minlength=len(place))
    weight = np.where(views >= _LEAST_VIEWS, views, 0) / np.sum(views[views >= _LEAST_VIEWS])
    away = (place - weight @ place)[:, :2]
    by_place = np.zeros((len(place), 3, 3))
    by_place[:, 0, :2] = weight[:, None] * away / np.sum(weight * np.sum(away**2, axis=1))
    by_place[:, 1, 0] = by_place[:, 2, 1] = weight
    of_point, of_world = point_jacobians(optimum)
    of_pose = np.zeros((reduced.size, 3))
    of_pose[reduced.structure.columns(WORLD)] = np.einsum("tqa,taw->wq", by_place, of_world)
    return of_pose, np.transpose(by_place @ of_point, (0, 2, 1)).reshape(-1, 3)


def _of_path(optimum: BundleOptimum, reduced: ReducedSystem) -> Array:
    """Return the derivatives (size, 3) of size and middle of the keyframes' positions by the pose side."""
    problem, values = optimum.problem, optimum.values
    w_T_b = metric_poses(problem, values)
    away = w_T_b[:, :2, 3] - w_T_b[:, :2, 3].mean(axis=0)
    by_place = np.zeros((len(w_T_b), 3, 3))
    by_place[:, 0, :2] = away / np.sum(away**2)
    by_place[:, 1, 0] = by_place[:, 2, 1] = 1.0 / len(w_T_b)
    J = by_place @ w_T_b[:, :3, :3] @ metric_jacobians(problem, values)[:, 3:]
    of_pose = np.zeros((reduced.size, 3))
    for k, each in enumerate(J):
        of_pose[reduced.structure.columns(POSE(k))] += each[:, :6].T
        of_pose[reduced.structure.columns(WORLD)] += each[:, 6:].T
    return of_pose
