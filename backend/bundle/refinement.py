"""Planar bundle adjustment: the refinement on the measurements themselves.

A pose graph takes its edges for independent and its attitudes for right. Here each floor point is a variable
seen from all its keyframes, so that nothing is counted twice, and what perspective says about tilt is used.
How much each kind of measurement is to be believed is estimated from its own residuals: attitudes that are
degrees off, a coarse GPS and a floor with relief are found to be so.

Pictures know everything but the scale. So the poses are kept in units of the mean height, the floor at z = 0,
and one variable (`backend.bundle.factors`) makes metres of them where a range or a position is compared. Were
the poses in metres, the assumption of a flat floor would pull the whole map to be small.

Source: Triggs et al. 2000 (bundle adjustment); Förstner and Wrobel 2016, section 4.2.4 (variance components).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.factors import (
    DATUM,
    FLOOR_Z,
    LOG_GAIN,
    LOG_SCALE,
    MOUNT,
    SLOPE,
    WORLD_SIZE,
    rotation_jacobian,
    rotation_of,
)
from backend.bundle.graph import (
    WORLD,
    BundleConfig,
    BundleProblem,
    NoiseLevels,
    ScalePrior,
    build_graph,
    metric_poses,
    start_values,
)
from backend.bundle.noise import estimate_noise, same_noise, start_noise
from backend.errors import BackendError
from backend.measurements import Measurements
from backend.pose_graph.marginals import joint_covariances
from backend.pose_graph.minimise import minimise
from backend.pose_graph.solution import RangeErrors
from backend.se3 import cross_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """Refined keyframes."""

    w_T_b: Array
    """(n, 4, 4)."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation."""
    over_floor_covariances: Array
    """(n, 6, 6) of where they stand over the floor: what the floor's own height and slope are off moves
    pictures and ground together."""
    floor_z_m: float
    """Of the floor under the origin."""
    floor_slope_rad: tuple[float, float]
    """Rotation vector (x, y) that takes the level to the floor."""
    focal_px: tuple[float, float]
    radial: tuple[float, float]
    """Radial coefficients (k1, k2) that go with ``focal_px``; zero where they were held."""
    b_T_c: Array
    """(4, 4) how the camera sits on the body, as found."""
    mount_std_rad: float
    """Of its tilt, about the less certain axis; 0 where it was held."""
    range_errors: RangeErrors | None
    """None where nothing was ranged."""
    scale_std: float | None
    """Relative; None where nothing told the scale."""
    conditional_scale_std: float
    """The same, conditioned on the gain and zero that all ranges share; 0 where nothing told it."""
    noise: NoiseLevels
    dropped_observations: int
    error: float
    iterations: int


def refine(
    measurements: Measurements,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    config: BundleConfig = BundleConfig(),
    on_step: Callable[[int, float], None] | None = None,
    lengths: ScalePrior | None = None,
    noise: NoiseLevels | None = None,
) -> Bundle:
    """Refine one connected set of keyframes, all of them in ``measurements.tracks``.

    ``w_T_b`` (n, 4, 4): a start within the basin of the optimum, such as the pose graph's; ``lengths`` tells
    of its scale; ``noise`` to start from is what the makers say, unless it is known better.
    Raises ``BackendError`` where the problem cannot be solved.
    """
    tracks, camera = measurements.tracks, measurements.camera
    if tracks is None or camera is None:
        raise BackendError(
            "bundle adjustment: no tracks of floor points, or no camera; solve the pose graph alone"
        )
    below = np.flatnonzero((w_T_b @ camera.b_T_c)[:, 2, 3] <= floor_z_m)
    if len(below):  # from there the descent may end anywhere
        raise BackendError(
            f"bundle adjustment: the camera of keyframe {below[0]} starts below the floor; "
            "the pose graph's result stands"
        )
    problem = BundleProblem(measurements, tracks, camera, config, calibrates=False, lengths=lengths)
    noise = noise or start_noise(measurements, config)
    values = start_values(problem, w_T_b, floor_z_m)
    start = values
    used = np.ones(len(tracks.track), bool)
    iterations = 0
    settled = False
    for number in range(config.rounds):
        if number == 1 and camera.focal_std_ratio > 0:
            # Only now: gtsam's factors with a free calibration forgive points behind the camera, which a
            # start far off would make use of.
            problem = replace(problem, calibrates=True)
            values.insert(CALIBRATION(0), gtsam.Cal3Bundler(camera.focal_px[0], 0, 0, *camera.center_px))
        graph = build_graph(problem, noise, used, start)
        last = settled or number + 1 == config.rounds
        tolerance = 1e-5 if last else 1e-3
        minimum = minimise(
            graph, values, max_iterations=30, relative_tolerance=tolerance, on_step=on_step, common=WORLD
        )
        values, iterations = minimum.values, iterations + minimum.iterations
        if last:
            break
        before = noise
        noise, used = estimate_noise(problem, values, noise, used)
        settled = number > 0 and same_noise(before, noise)
    return _result(problem, graph, values, noise, used, minimum.error, iterations)


def metric_jacobians(problem: BundleProblem, values: gtsam.Values, origin: Array) -> Array:
    """(n, 6, 6 + w) from perturbations of a pose and the world to those of the body's pose in metres.

    ``origin`` (3,), in mean heights, stays where it is when the scale changes.
    """
    n, world = problem.measurements.count, values.atVector(WORLD)
    scale = float(np.exp(world[LOG_SCALE]))
    A, turn, mount_turn = (
        rotation_of(world, SLOPE),
        rotation_jacobian(world, SLOPE),
        rotation_jacobian(world, MOUNT),
    )
    jacobians = np.zeros((n, 6, 6 + WORLD_SIZE))
    for k, J in enumerate(jacobians):
        pose = values.atPose3(POSE(k)).matrix()
        of_world = J[:, 6:]
        J[:3, :3] = np.eye(3)
        J[3:, 3:6] = scale * np.eye(3)
        R, p = pose[:3, :3], pose[:3, 3] - origin
        of_world[3:, LOG_SCALE] = scale * R.T @ p
        of_world[3:, FLOOR_Z] = (A @ R)[2]
        # A right perturbation of the slope turns the whole map about the floor under the origin.
        of_world[:3, SLOPE] = R.T @ turn
        of_world[3:, SLOPE] = -scale * R.T @ cross_matrix(p) @ turn
        # The camera stays where it is; the body turns about it the other way.
        of_world[:3, MOUNT] = -mount_turn
    return np.asarray(gtsam.Pose3(problem.b_T_c(values)).AdjointMap() @ jacobians)


def _metric_covariances(problem: BundleProblem, joint: Array, values: gtsam.Values) -> tuple[Array, Array]:
    """(n, 6, 6) of body poses in metres, in the world and over the floor, from those of pose and world
    together (n, 6 + w, 6 + w)."""
    # Without positions the first keyframe is the origin by definition, its height above the floor included.
    first = np.zeros(3) if problem.measurements.positions else values.atPose3(POSE(0)).translation()
    in_world = metric_jacobians(problem, values, first)
    # Over the floor the origin is the point under it.
    over_floor = metric_jacobians(problem, values, first * [1.0, 1.0, 0.0])
    over_floor[:, :, 6 + FLOOR_Z] = 0.0
    over_floor[:, :, 6:][:, :, SLOPE] = 0.0
    return _carried(in_world, joint), _carried(over_floor, joint)


def _carried(J: Array, covariances: Array) -> Array:
    return np.asarray(J @ covariances @ np.swapaxes(J, 1, 2))


def _result(
    problem: BundleProblem,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    noise: NoiseLevels,
    used: NDArray[np.bool_],
    error: float,
    iterations: int,
) -> Bundle:
    heights = np.array([values.atPose3(POSE(k)).z() for k in range(problem.measurements.count)])
    if not (np.isfinite(heights).all() and (heights > 0).all()):
        raise BackendError("bundle adjustment: a camera went below the floor; the pose graph's result stands")
    focal, radial = problem.camera.focal_px, (0.0, 0.0)
    if problem.calibrates:
        found = values.atCal3Bundler(CALIBRATION(0))
        focal, radial = (found.fx(), found.fx()), (found.k1(), found.k2())
    world = values.atVector(WORLD)
    poses = [POSE(k) for k in range(problem.measurements.count)]
    joint = joint_covariances(graph, values, poses, WORLD)
    mount_std = float(np.sqrt(np.diag(joint[0, 6:, 6:])[MOUNT].max()))
    return Bundle(
        metric_poses(problem, values),
        *_metric_covariances(problem, joint, values),
        float(world[FLOOR_Z]),
        (float(world[SLOPE][0]), float(world[SLOPE][1])),
        focal,
        radial,
        problem.b_T_c(values),
        mount_std if problem.camera.mount_std_rad > 0 else 0.0,
        _range_errors(world, joint[0, 6:, 6:]) if problem.measurements.ranges else None,
        float(np.sqrt(joint[0, 6 + LOG_SCALE, 6 + LOG_SCALE])) if problem.scaled else None,
        _own_scale_std(joint[0, 6:, 6:]) if problem.scaled else 0.0,
        noise,
        int((~used).sum()),
        error,
        iterations,
    )


def _own_scale_std(covariance: Array) -> float:
    """Standard deviation of the scale, conditioned on gain and zero of the ranges, which all parts of a
    flight share."""
    shared, scale = [LOG_GAIN, DATUM], LOG_SCALE
    along = covariance[scale, shared]
    told = along @ np.linalg.solve(covariance[np.ix_(shared, shared)], along)
    return float(np.sqrt(max(covariance[scale, scale] - told, 0.0)))


def _range_errors(world: Array, covariance: Array) -> RangeErrors:
    gain, std = float(np.exp(world[LOG_GAIN])), np.sqrt(np.diag(covariance))
    return RangeErrors(gain, gain * float(std[LOG_GAIN]), float(world[DATUM]), float(std[DATUM]))
