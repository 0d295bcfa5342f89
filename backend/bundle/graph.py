"""The pose-side factors of the planar bundle adjustment, and its start: sensors, calibration, gauge."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.aligned_pairs import add_aligned
from backend.bundle.barometer import height_factor, heights_prior
from backend.bundle.control import ControlWeights, add_control, start_control
from backend.bundle.exposure_motion import add_readout
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
    body_up,
    level_factor,
    scaled_position_factor,
    scaled_range_factor,
)
from backend.bundle.floor_points import intersect_floor
from backend.bundle.inertial.graph import (
    NOMINAL_INERTIAL_NOISE,
    add_inertial,
)
from backend.bundle.lens import add_calibration, start_numbers
from backend.bundle.noise_level import over_typical, positions_over_typical
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.problem import BundleProblem, NoiseLevels, Variables
from backend.bundle.reported.graph import add_reported
from backend.measurements import PinholeModel
from backend.robust import robust

Array = NDArray[np.float64]


_OPEN_M = 1e5
"""Standard deviation of a length of the world that no prior tells: of the floor's height, and of the offset
between positions and control points. With a tighter one, an offset beyond it would count as noise of the
positions."""


def start_variables(problem: BundleProblem, w_T_b: Array, floor_z_m: float) -> Variables:
    """Return initial values: poses in units of the mean height, points at the mean intersections of rays."""
    tracks, camera = problem.tracks, problem.camera
    w_T_c = w_T_b @ camera.b_T_c
    w_T_c[:, 2, 3] -= floor_z_m
    scale = float(np.median(w_T_c[:, 2, 3]))
    w_T_c[:, :3, 3] /= scale
    values = gtsam.Values()
    for k, pose in enumerate(w_T_c):
        values.insert(POSE(k), gtsam.Pose3(pose))
    world = np.zeros(WORLD_SIZE)
    world[LOG_SCALE], world[FLOOR_Z] = np.log(scale), floor_z_m
    world[ANTENNA] = problem.measurements.antenna_m
    values.insert(WORLD, world)
    start_control(values, problem.measurements, camera, w_T_c)
    return Variables(values, intersect_floor(tracks, camera, w_T_c))


def pose_side_factors(problem: BundleProblem, noise: NoiseLevels, start: gtsam.Values) -> PoseSideFactors:
    """Build the factors of everything but the floor points: sensors, calibration and gauge."""
    pose_side = PoseSideFactors()
    _add_sensors(pose_side, problem, noise)
    lens = None if problem.self_calibrates else start_numbers(problem.camera)
    weights = ControlWeights(noise.control, noise.marks, problem.config.huber_sigmas)
    add_control(pose_side, problem.measurements.control, lens, weights, problem.exposure_motion)
    if problem.self_calibrates:
        add_calibration(pose_side, problem.camera)
    if problem.exposure_motion is not None:
        add_readout(pose_side, problem.exposure_motion)
    _add_gauge(pose_side, problem, start, noise)
    if problem.measurements.heights:
        pose_side.add("barometer prior", heights_prior(start))
    add_aligned(pose_side, problem.measurements.aligned, problem.camera, start)
    b_T_c = problem.camera.b_T_c
    if problem.reported is not None:
        add_reported(pose_side, problem.reported, b_T_c, noise.reported)
        if problem.inertial is None:
            problem.reported.path.frames.add(pose_side, start, NOMINAL_INERTIAL_NOISE.frames)
    if problem.inertial is not None:
        add_inertial(pose_side, problem.inertial, start, b_T_c, noise.inertial)
    return pose_side


def start_calibration(at: Variables, camera: PinholeModel) -> Variables:
    """Return the variables with the initial calibration."""
    values = gtsam.Values(at.values)
    values.insert(CALIBRATION(0), start_numbers(camera))
    return Variables(values, at.point)


def _add_sensors(pose_side: PoseSideFactors, problem: BundleProblem, noise: NoiseLevels) -> None:
    """Add factors of attitudes, ranges and positions."""
    measurements, c_T_b = problem.measurements, problem.c_T_b
    if measurements.attitudes:
        ratio = over_typical([a.std_rad[:2].max() for a in measurements.attitudes])
        for a, std in zip(measurements.attitudes, noise.roll_pitch_rad * ratio, strict=True):
            c_up = c_T_b[:3, :3] @ body_up(a.roll_pitch_yaw_rad)
            model = robust(gtsam.noiseModel.Isotropic.Sigma(2, std))
            pose_side.add("attitude", level_factor(POSE(a.k), c_up, model))
    if measurements.ranges:
        ratio = over_typical([r.to_level_std_m for r in measurements.ranges])
        for r, std in zip(measurements.ranges, noise.range_m * ratio, strict=True):
            model = robust(gtsam.noiseModel.Isotropic.Sigma(1, std))
            factor = scaled_range_factor(POSE(r.k), r.to_level_m, model, c_T_b @ r.b_T_s)
            pose_side.add("range", factor)
    if measurements.positions:
        over = positions_over_typical(measurements.positions)
        for p, std_m in zip(measurements.positions, noise.position_m * over, strict=True):
            # An axis with an infinite deviation was not measured: it has no weight.
            measured = np.isfinite(p.std_m)
            precision = np.where(measured, std_m**-2.0, 0.0)
            model = robust(gtsam.noiseModel.Diagonal.Precisions(precision), int(measured.sum()))
            pose_side.add("position", scaled_position_factor(POSE(p.k), p.w_p_antenna_m, model, c_T_b))
    if measurements.heights:
        ratio = over_typical([h.std_m for h in measurements.heights])
        for h, std in zip(measurements.heights, noise.height_m * ratio, strict=True):
            model = robust(gtsam.noiseModel.Isotropic.Sigma(1, std))
            factor = height_factor(POSE(h.k), h.height_m, model, problem.camera.b_T_c)
            pose_side.add("barometer height", factor)


def _add_gauge(
    pose_side: PoseSideFactors, problem: BundleProblem, start: gtsam.Values, noise: NoiseLevels
) -> None:
    """Add priors that fix unobserved quantities at their initial values.

    The first keyframe's height in the poses' unit is always fixed (the scale is another variable). Without
    positions its position, its heading and the floor's height are fixed too; so is an unobserved scale.
    """
    fixed_std, free_std = 1e-5, 1e3
    measured, placed = problem.measurements, problem.measurements.placed
    first, plane = start.atPose3(POSE(0)), free_std if placed else fixed_std
    place = gtsam.noiseModel.Diagonal.Sigmas(np.array([plane, plane, fixed_std]))
    pose_side.add("gauge", gtsam.PoseTranslationPrior3D(POSE(0), first, place))
    heading = gtsam.noiseModel.Diagonal.Sigmas(np.array([free_std, free_std, plane]))
    pose_side.add("gauge", gtsam.PoseRotationPrior3D(POSE(0), first, heading))
    sigmas = np.full(WORLD_SIZE, fixed_std)
    sigmas[LOG_SCALE] = free_std if problem.has_scale else fixed_std
    raised = measured.control or any(np.isfinite(p.std_m[2]) for p in measured.positions)
    sigmas[FLOOR_Z] = _OPEN_M if raised else fixed_std
    sigmas[LOG_GAIN] = max(measured.range_gain_std, fixed_std)
    # A beam measures a level within the relief with a constant bias, its tops for example.
    relief_m = noise.relief * float(np.exp(start.atVector(WORLD)[LOG_SCALE]))
    sigmas[DATUM] = max(float(np.hypot(measured.range_datum_std_m, relief_m)), fixed_std)
    sigmas[SLOPE] = noise.slope_rad if placed else fixed_std
    sigmas[MOUNT] = max(problem.camera.mount_std_rad, fixed_std)
    sigmas[OFFSET] = np.where(measured.axes_of_both, _OPEN_M, fixed_std)
    level, up = measured.antenna_std_m, max(measured.antenna_std_m, measured.antenna_up_std_m)
    sigmas[ANTENNA] = np.maximum([level, level, up], fixed_std)
    world = start.atVector(WORLD)
    if problem.scale_prior is not None:
        sigmas[LOG_SCALE] = problem.scale_prior.log_std
        world[LOG_SCALE] += np.log(problem.scale_prior.ratio)
    model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    prior = gtsam.PriorFactorVector(WORLD, world, model)
    pose_side.add("world prior", prior, _world_instruments(problem.scale_prior is not None))


def _world_instruments(by_imu: bool) -> list[str]:
    """Return the instrument of each number of the world variable; ``by_imu`` if the IMU gives its scale."""
    found = ["assumed"] * WORLD_SIZE
    found[LOG_GAIN] = found[DATUM] = "range"
    found[MOUNT] = ["pictures"] * len(found[MOUNT])
    if by_imu:
        found[LOG_SCALE] = "imu"
    return found
