"""Metric poses of the body, and their Jacobians by the variables of a refinement."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import FLOOR_Z, SLOPE
from backend.bundle.problem import BundleProblem

Array = NDArray[np.float64]


def metric_poses(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Return body poses (n, 4, 4) in metres in the measured world."""
    transform = problem.transform(values)
    poses = (values.atPose3(POSE(k)) for k in range(problem.measurements.count))
    return np.array([transform.body_pose(pose).matrix() for pose in poses])


def metric_jacobians(problem: BundleProblem, values: gtsam.Values, fixed: Array | None = None) -> Array:
    """Return the Jacobian (n, 6, 6 + w) of metric body poses by perturbations of pose and world.

    ``fixed`` (3,), in mean heights, is the fixed point of a change of scale, by default the `origin`.
    """
    fixed = origin(problem, values) if fixed is None else fixed
    transform = problem.transform(values)
    poses = (values.atPose3(POSE(k)) for k in range(problem.measurements.count))
    return np.array([transform.jacobian(pose, fixed) for pose in poses])


def over_floor_jacobians(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Return the same (n, 6, 6 + w) of body poses relative to the floor: its height and slope are no part."""
    # The fixed point is that of the floor below the origin.
    J = metric_jacobians(problem, values, origin(problem, values) * [1.0, 1.0, 0.0])
    J[:, :, 6 + FLOOR_Z] = 0.0
    J[:, :, 6:][:, :, SLOPE] = 0.0
    return J


def origin(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Return (3,) the point that is the origin: without positions, the first keyframe by definition."""
    return np.zeros(3) if problem.measurements.placed else values.atPose3(POSE(0)).translation()


def propagated(J: Array, covariances: Array) -> Array:
    """Return covariances (n, p, p) of quantities with the Jacobians (n, p, q) by variables, from the
    variables' own (n, q, q)."""
    return np.asarray(J @ covariances @ np.swapaxes(J, 1, 2))
