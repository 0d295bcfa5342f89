"""Planar bundle adjustment on the image observations.

A pose graph assumes independent edges and correct attitudes. Here each floor point is a variable that all its
keyframes observe, so that nothing is counted twice, and perspective contributes to the tilt. The noise of
each kind of measurement is estimated from its residuals, so that attitudes with errors of degrees, a coarse
GPS and a floor with relief get their correct weights.

Pictures observe everything except the scale. The poses are in units of the mean height, with the floor at
z = 0, and one variable (`backend.bundle.factors`) converts them to metres for ranges and positions. With
poses in metres, the assumption of a flat floor would bias the whole map towards a smaller scale.

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

from backend.bundle.accuracy.ground_size import GroundSize, ground_size
from backend.bundle.accuracy.row_motion_errors import row_motion_covariances
from backend.bundle.barometer import HEIGHTS, start_heights
from backend.bundle.factors import (
    ANTENNA,
    DATUM,
    FLOOR_Z,
    LOG_GAIN,
    LOG_SCALE,
    MOUNT,
    OFFSET,
    SLOPE,
    WORLD,
    WORLD_SIZE,
)
from backend.bundle.graph import start_variables
from backend.bundle.inertial.graph import InertialPart
from backend.bundle.inertial_noise import start_factors
from backend.bundle.lens import LensEstimate, prior_covariance, start_numbers
from backend.bundle.metric_poses import (
    metric_jacobians,
    metric_poses,
    over_floor_jacobians,
    propagated,
)
from backend.bundle.minimise import BundleOptimum
from backend.bundle.model_selection import solve_best_model
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem, NoiseLevels, ScalePrior, Variables
from backend.bundle.reported.graph import ReportedPart
from backend.bundle.rolling_shutter import ReadoutEstimate, row_motion, with_known_readout
from backend.bundle.rounds import Solved, reported_noise
from backend.errors import BackendError
from backend.measurements import Measurements, PinholeModel
from backend.pose_graph.solution import RangeErrors
from backend.sparse_cholesky import SingularMatrixError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """Refined keyframes."""

    w_T_b: Array
    """(n, 4, 4)."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation."""
    over_floor_covariances: Array
    """(n, 6, 6) covariance relative to the floor: errors of the floor's height and slope move poses and
    ground together."""
    floor_z_m: float
    """Height of the floor under the origin."""
    floor_slope_rad: tuple[float, float]
    """Rotation vector (x, y) from the horizontal plane to the floor."""
    position_offset_m: Array
    """(3,) by which measured positions lie off the control points' datum; 0 without both."""
    position_offset_std_m: Array
    """(3,)."""
    antenna_m: Array
    """(3,) point of the body that measured positions belong to."""
    antenna_std_m: Array
    """(3,)."""
    antenna_covariances: Array
    """(n, 3, 3) covariance of the antenna's position at each pose, in world axes. With an estimated
    place it is smaller than that of the body, whose errors the antenna's undo."""
    lens: LensEstimate | None
    """None if the calibration was fixed."""
    readout: ReadoutEstimate | None
    """Read-out time of the shutter; None where nothing is known of how the rows were exposed."""
    row_motion_m: Array | None
    """(n, 3) motion of the cameras in body axes from the first row to the last; None for a global shutter."""
    row_turn_rad: Array | None
    """(n, 3) how they turn meanwhile; 0 of photographs, and None for a global shutter."""
    b_T_c: Array
    """(4, 4) estimated mount of the camera."""
    mount_std_rad: float
    """Standard deviation of its tilt about the less certain axis; 0 if it was fixed."""
    range_errors: RangeErrors | None
    """None without ranges."""
    scale_std: float | None
    """Relative standard deviation that all lengths on the ground share; None if the scale is unobserved."""
    middle_std_m: float
    """Standard deviation of the place of the whole ground, x and y together (`ground_size` beside)."""
    conditional_scale_std: float
    """Relative standard deviation of the camera's height over the floor, conditioned on gain and zero offset
    of the ranges; 0 if the scale is unobserved."""
    noise: NoiseLevels
    dropped_observations: int
    error: float
    iterations: int
    not_converged: str
    """Reason why the last solve ended before it converged, in words; empty if it converged."""
    optimum: BundleOptimum
    """The solved graph, for further tests of the solution."""

    @property
    def uses_barometer(self) -> bool:
        """Whether heights of a barometer are in the graph."""
        return bool(self.optimum.problem.measurements.heights)

    @property
    def uses_reported_motion(self) -> bool:
        """Whether velocity and turns that the vehicle reports are in the graph."""
        return self.optimum.problem.reported is not None

    @property
    def reported_damage(self) -> str:
        """Reason why the reported motion cannot be right, in words; empty if it can be, or without any."""
        part = self.optimum.problem.reported
        return "" if part is None else part.damage(self.optimum.values, self.optimum.transform)


def refine(
    measurements: Measurements,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    config: BundleConfig = BundleConfig(),
    on_step: Callable[[int, float], None] | None = None,
    scale_prior: ScalePrior | None = None,
    noise: NoiseLevels | None = None,
) -> Bundle:
    """Refine one connected set of keyframes, all of them in ``measurements.tracks``.

    ``w_T_b`` (n, 4, 4) is an initial guess within the basin of the optimum, such as the pose graph's.
    ``scale_prior`` refers to its scale. The default initial ``noise`` is that of the measurements.
    Raises ``BackendError`` if the problem cannot be solved.
    """
    tracks, camera = measurements.tracks, measurements.camera
    if tracks is None or camera is None:
        raise BackendError(
            "bundle adjustment: no tracks of floor points, or no camera; solve the pose graph alone"
        )
    _check_start(w_T_b, camera, floor_z_m)
    problem = BundleProblem(
        measurements, tracks, camera, config, self_calibrates=False, scale_prior=scale_prior
    )
    nominal = start_noise(measurements, config)
    at = _with_heights(problem, start_variables(problem, w_T_b, floor_z_m))
    problem, at = _with_motion(problem, at)
    problem, at = with_known_readout(problem, at)
    noise = replace(
        noise or nominal,
        height_m=nominal.height_m,
        inertial=start_factors(problem, at.values),
        reported=reported_noise(problem, at.values),
    )
    return _result(*solve_best_model(problem, at, noise, on_step))


def _check_start(w_T_b: Array, camera: PinholeModel, floor_z_m: float) -> None:
    """Raise ``BackendError`` for a start (n, 4, 4) from which no solution is found."""
    unknown = np.flatnonzero(~np.isfinite(w_T_b).all(axis=(1, 2)))
    if len(unknown):
        raise BackendError(
            f"bundle adjustment: the start of keyframe {unknown[0]} is not finite; give it one"
        )
    below = np.flatnonzero((w_T_b @ camera.b_T_c)[:, 2, 3] <= floor_z_m)
    if len(below):  # from there the solve may end anywhere
        raise BackendError(
            f"bundle adjustment: the camera of keyframe {below[0]} starts below the floor; "
            "the pose graph's result stands"
        )


def _with_heights(problem: BundleProblem, at: Variables) -> Variables:
    """Insert gain and zero of the barometer, at the scale that it tells where nothing else does."""
    measured = problem.measurements
    if not measured.heights:
        return at
    has_scale = problem.has_lengths or measured.inertial is not None or measured.reported is not None
    values = gtsam.Values(at.values)
    world, gain_zero = start_heights(
        measured.heights, metric_poses(problem, values), values.atVector(WORLD), tells_scale=not has_scale
    )
    values.update(WORLD, world)
    values.insert(HEIGHTS, gain_zero)
    return replace(at, values=values)


def _with_motion(problem: BundleProblem, at: Variables) -> tuple[BundleProblem, Variables]:
    """Integrate inertial readings and reported motion, if there are any, and insert their variables."""
    camera, measured = problem.camera, problem.measurements
    reported = ReportedPart.of(measured, camera)
    if reported is not None:
        if not (measured.inertial or problem.has_lengths):
            at = _scaled(reported, problem, at)
        at = replace(at, values=reported.start(at.values))
    transform = problem.transform(at.values)
    inertial = InertialPart.of(measured, camera, at.values, transform)
    if inertial is not None:
        at = replace(at, values=inertial.start(at.values, transform))
    return replace(problem, inertial=inertial, reported=reported), at


def _scaled(reported: ReportedPart, problem: BundleProblem, at: Variables) -> Variables:
    """Return the variables at the scale of reported lengths: nothing else determines it."""
    values, world = gtsam.Values(at.values), at.values.atVector(WORLD)
    ratio = reported.length_ratio(reported.path.placed(values), problem.transform(values))
    world[LOG_SCALE] += np.log(ratio) if ratio > 0 else 0.0
    values.update(WORLD, world)
    return replace(at, values=values)


def _metric_covariances(problem: BundleProblem, joint: Array, values: gtsam.Values) -> tuple[Array, Array]:
    """Return covariances (n, 6, 6) of metric body poses, in the world and relative to the floor.

    ``joint`` (n, 6 + w, 6 + w) holds the joint covariances of pose and world.
    """
    in_world = metric_jacobians(problem, values)
    return propagated(in_world, joint), propagated(over_floor_jacobians(problem, values), joint)


def _antenna_covariances(problem: BundleProblem, joint: Array, values: gtsam.Values) -> Array:
    """Return covariances (n, 3, 3) of the antenna's positions, from the same ``joint`` ones."""
    antenna_m = values.atVector(WORLD)[ANTENNA]
    w_R_b = metric_poses(problem, values)[:, :3, :3]
    # A right perturbation (r, t) moves the antenna by R (t - a x r).
    of_pose = np.concatenate([-w_R_b @ gtsam.Rot3.Hat(antenna_m), w_R_b], axis=2)
    J = of_pose @ metric_jacobians(problem, values)
    J[:, :, 6:][:, :, ANTENNA] += w_R_b
    return propagated(J, joint)


def _result(solved: Solved, readout: ReadoutEstimate | None) -> Bundle:
    optimum, last = solved.optimum, solved.minimum
    problem, values = optimum.problem, optimum.values
    heights = np.array([values.atPose3(POSE(k)).z() for k in range(problem.measurements.count)])
    if not (np.isfinite(heights).all() and (heights > 0).all()):
        raise BackendError("bundle adjustment: a camera went below the floor; the pose graph's result stands")
    world = values.atVector(WORLD)
    joint, of_lens, size = _covariances(optimum, readout.std_s if readout else 0.0)
    world_std = np.sqrt(np.diag(joint[0, 6:, 6:]))
    in_world, over_floor = _metric_covariances(problem, joint, values)
    row_motion_m, row_turn_rad = row_motion(optimum)
    return Bundle(
        w_T_b=metric_poses(problem, values),
        covariances=in_world,
        over_floor_covariances=over_floor,
        floor_z_m=float(world[FLOOR_Z]),
        floor_slope_rad=(float(world[SLOPE][0]), float(world[SLOPE][1])),
        position_offset_m=world[OFFSET],
        position_offset_std_m=world_std[OFFSET],
        antenna_m=world[ANTENNA],
        antenna_std_m=world_std[ANTENNA],
        antenna_covariances=_antenna_covariances(problem, joint, values),
        lens=_lens(problem, values, of_lens) if problem.self_calibrates else None,
        readout=readout,
        row_motion_m=row_motion_m,
        row_turn_rad=row_turn_rad,
        b_T_c=problem.b_T_c(values),
        mount_std_rad=float(world_std[MOUNT].max()) if problem.camera.mount_std_rad > 0 else 0.0,
        range_errors=_range_errors(problem.measurements, world, joint[0, 6:, 6:]),
        scale_std=size.log_std if problem.has_scale else None,
        middle_std_m=size.middle_std_m,
        conditional_scale_std=_conditional_scale_std(joint[0, 6:, 6:]) if problem.has_scale else 0.0,
        noise=optimum.noise,
        dropped_observations=int((~optimum.used).sum()),
        error=last.error,
        iterations=solved.iterations,
        not_converged="" if last.converged else last.reason,
        optimum=optimum,
    )


def _covariances(optimum: BundleOptimum, readout_std_s: float) -> tuple[Array, Array, GroundSize]:
    """Return joint covariances (n, 6 + w, 6 + w) of each pose and the world, the calibration's (q, q), q = 0
    if it is fixed, and the uncertainty of the ground's size; NaN if undetermined.

    ``readout_std_s`` is the standard deviation of an estimated read-out time.
    """
    poses = [POSE(k) for k in range(optimum.problem.measurements.count)]
    q = start_numbers(optimum.problem.camera).size if optimum.problem.self_calibrates else 0
    try:
        linear = optimum.linearise()
        reduced = linear.eliminate()
        joint = reduced.joint_covariances(poses, WORLD)
        joint += row_motion_covariances(optimum, linear, reduced, readout_std_s)
        return joint, reduced.calibration_covariance, ground_size(optimum, reduced)
    except SingularMatrixError:
        joint = np.full((len(poses), 6 + WORLD_SIZE, 6 + WORLD_SIZE), np.nan)
        return joint, np.full((q, q), np.nan), GroundSize(np.nan, np.nan)


def _lens(problem: BundleProblem, values: gtsam.Values, covariance: Array) -> LensEstimate:
    prior_std = np.sqrt(np.diag(prior_covariance(problem.camera)))
    found, std = values.atVector(CALIBRATION(0)), np.sqrt(np.diag(covariance))
    return LensEstimate(problem.camera.lens, found, std, prior_std)


def _conditional_scale_std(covariance: Array) -> float:
    """Return the standard deviation of the scale, given gain and zero offset of the ranges."""
    shared, scale = [LOG_GAIN, DATUM], LOG_SCALE
    along = covariance[scale, shared]
    explained = along @ np.linalg.solve(covariance[np.ix_(shared, shared)], along)
    return float(np.sqrt(max(covariance[scale, scale] - explained, 0.0)))


def _range_errors(measured: Measurements, world: Array, covariance: Array) -> RangeErrors | None:
    if not measured.ranges:
        return None
    gain, std = float(np.exp(world[LOG_GAIN])), np.sqrt(np.diag(covariance))
    return RangeErrors(
        gain=gain,
        gain_std=gain * float(std[LOG_GAIN]),
        zero_m=float(world[DATUM]),
        zero_std_m=float(std[DATUM]),
        gain_prior_std=measured.range_gain_std,
        zero_prior_std_m=measured.range_datum_std_m,
    )
