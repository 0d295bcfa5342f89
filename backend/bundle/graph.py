"""The factor graph of the planar bundle adjustment: projections, floor, sensors, gauge."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
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
    body_up,
    level_factor,
    rotation_of,
    scaled_position_factor,
    scaled_range_factor,
)
from backend.bundle.floor_points import intersect_floor
from backend.measurements import FloorTracks, Measurements, PinholeModel

Array = NDArray[np.float64]
WORLD = gtsam.symbol("w", 0)


@dataclass(frozen=True)
class BundleConfig:
    """How the refinement goes about it."""

    rounds: int = 10
    """Solves at most; between two of them the noise of each kind of measurement is estimated anew, until it
    stays. A lens that is not known is free from the second on."""
    huber_sigmas: float = 2.0
    drop_sigmas: float = 6.0
    """Observations farther off than this are dropped between rounds, and counted."""
    slope_std_rad: float = 0.05
    """How far ground may lean; only positions tell."""
    start_relief: float = 0.01
    """Standard deviation of the floor's relief over the mean height, to start from."""


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations as the residuals show them."""

    pixel_scale: float
    """Factor on the observations' own std_px."""
    relief: float
    """Of the floor, over the mean height."""
    roll_pitch_rad: float
    position_m: Array
    """(3,)."""
    range_m: float


@dataclass(frozen=True)
class ScalePrior:
    """What something else than ranges and positions tells of the scale."""

    ratio: float
    """True lengths over those of the start."""
    log_std: float


@dataclass(frozen=True)
class BundleProblem:
    """Everything that stays fixed over a round."""

    measurements: Measurements
    tracks: FloorTracks
    camera: PinholeModel
    config: BundleConfig
    calibrates: bool
    lengths: ScalePrior | None = None

    @property
    def scaled(self) -> bool:
        """Whether anything tells the scale."""
        measured = self.measurements
        return bool(measured.ranges or measured.positions) or self.lengths is not None

    @property
    def c_T_b(self) -> Array:
        """Body coordinates to camera coordinates, as the mount was told."""
        return np.asarray(np.linalg.inv(self.camera.b_T_c), dtype=float)

    def b_T_c(self, values: gtsam.Values) -> Array:
        """Camera coordinates to body coordinates, as the mount is found to be."""
        turn = np.eye(4)
        turn[:3, :3] = rotation_of(values.atVector(WORLD), MOUNT)
        return np.asarray(self.camera.b_T_c @ turn)


def start_values(problem: BundleProblem, w_T_b: Array, floor_z_m: float) -> gtsam.Values:
    """Given poses in heights above the floor; each point where its rays meet the floor, on average."""
    tracks, camera = problem.tracks, problem.camera
    w_T_c = w_T_b @ camera.b_T_c
    w_T_c[:, 2, 3] -= floor_z_m
    scale = float(np.median(w_T_c[:, 2, 3]))
    w_T_c[:, :3, 3] /= scale
    values = gtsam.Values()
    for k, pose in enumerate(w_T_c):
        values.insert(POSE(k), gtsam.Pose3(pose))
    for t, point in enumerate(intersect_floor(tracks, camera, w_T_c)):
        values.insert(POINT(t), point)
    values.insert(WORLD, np.array([np.log(scale), floor_z_m, *[0.0] * (WORLD_SIZE - 2)]))
    return values


def build_graph(
    problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_], start: gtsam.Values
) -> gtsam.NonlinearFactorGraph:
    """The factor graph at the given noise levels."""
    graph = gtsam.NonlinearFactorGraph()
    _add_observations(graph, problem, noise, used)
    flat = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e4, 1e4, noise.relief]))
    for t in range(int(problem.tracks.track.max()) + 1):
        graph.push_back(gtsam.PriorFactorPoint3(POINT(t), np.zeros(3), flat))
    _add_sensors(graph, problem, noise)
    _add_gauge(graph, problem, start, noise.relief)
    return graph


def _add_observations(
    graph: gtsam.NonlinearFactorGraph, problem: BundleProblem, noise: NoiseLevels, used: NDArray[np.bool_]
) -> None:
    """One projection a visible point, Huber-robust."""
    tracks, camera = problem.tracks, problem.camera
    models: dict[float, gtsam.noiseModel.Base] = {}
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(problem.config.huber_sigmas)
    fixed = gtsam.Cal3_S2(*camera.focal_px, 0.0, *camera.center_px)
    std = np.round(tracks.std_px * noise.pixel_scale, 4)
    for m in np.flatnonzero(used):
        sigma = float(std[m])
        if sigma not in models:
            models[sigma] = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(2, sigma))
        keys = POSE(int(tracks.keyframe[m])), POINT(int(tracks.track[m]))
        if problem.calibrates:
            factor: gtsam.NonlinearFactor = gtsam.GeneralSFMFactor2Cal3Bundler(
                tracks.pixel[m], models[sigma], *keys, CALIBRATION(0)
            )
        else:
            # Not to throw: a point behind the camera must cost, not vanish from the sum.
            factor = gtsam.GenericProjectionFactorCal3_S2(
                tracks.pixel[m], models[sigma], *keys, fixed, False, False
            )
        graph.push_back(factor)
    if problem.calibrates:
        start = gtsam.Cal3Bundler(camera.focal_px[0], 0, 0, *camera.center_px)
        sigmas = np.array([camera.focal_px[0] * camera.focal_std_ratio, camera.radial_std, camera.radial_std])
        model = gtsam.noiseModel.Diagonal.Sigmas(np.maximum(sigmas, 1e-6))
        graph.push_back(gtsam.PriorFactorCal3Bundler(CALIBRATION(0), start, model))


def _add_sensors(graph: gtsam.NonlinearFactorGraph, problem: BundleProblem, noise: NoiseLevels) -> None:
    """Attitudes, ranges and positions."""
    measurements, c_T_b = problem.measurements, problem.c_T_b
    if measurements.attitudes:
        model: gtsam.noiseModel.Base = gtsam.noiseModel.Isotropic.Sigma(2, noise.roll_pitch_rad)
        for a in measurements.attitudes:
            c_up = c_T_b[:3, :3] @ body_up(a.roll_pitch_yaw_rad)
            graph.push_back(level_factor(POSE(a.k), WORLD, c_up, model))
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    if measurements.ranges:
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(1, noise.range_m))
        for r in measurements.ranges:
            graph.push_back(scaled_range_factor(POSE(r.k), WORLD, r.range_m, model, c_T_b @ r.b_T_s))
    if measurements.positions:
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Diagonal.Sigmas(noise.position_m))
        for p in measurements.positions:
            graph.push_back(scaled_position_factor(POSE(p.k), WORLD, p.w_p_b_m, model, c_T_b))


def _add_gauge(
    graph: gtsam.NonlinearFactorGraph, problem: BundleProblem, start: gtsam.Values, relief: float
) -> None:
    """Hold what nothing observes at its start.

    Always the first keyframe's height in the poses' own unit (the scale is a variable of its own); without
    positions its place and heading and the floor's height too; the scale unless something tells it.
    """
    held, free = 1e-5, 1e3
    placed = bool(problem.measurements.positions)
    first, plane = start.atPose3(POSE(0)), free if placed else held
    place = gtsam.noiseModel.Diagonal.Sigmas(np.array([plane, plane, held]))
    graph.push_back(gtsam.PoseTranslationPrior3D(POSE(0), first, place))
    heading = gtsam.noiseModel.Diagonal.Sigmas(np.array([free, free, plane]))
    graph.push_back(gtsam.PoseRotationPrior3D(POSE(0), first, heading))
    sigmas = np.full(WORLD_SIZE, held)
    sigmas[LOG_SCALE] = free if problem.scaled else held
    sigmas[FLOOR_Z] = 1e5 if placed else held
    sigmas[LOG_GAIN] = max(problem.measurements.range_gain_std, held)
    # A beam hears the floor somewhere within its relief, always alike: its tops, or what lies between them.
    heard_m = relief * float(np.exp(start.atVector(WORLD)[LOG_SCALE]))
    sigmas[DATUM] = max(float(np.hypot(problem.measurements.range_datum_std_m, heard_m)), held)
    sigmas[SLOPE] = problem.config.slope_std_rad if placed else held
    sigmas[MOUNT] = max(problem.camera.mount_std_rad, held)
    world = start.atVector(WORLD)
    if problem.lengths is not None:
        sigmas[LOG_SCALE] = problem.lengths.log_std
        world[LOG_SCALE] += np.log(problem.lengths.ratio)
    model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    graph.push_back(gtsam.PriorFactorVector(WORLD, world, model))


def metric_poses(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Body poses (n, 4, 4) in metres in the measured world."""
    world = values.atVector(WORLD)
    w_T_f = np.eye(4)
    w_T_f[:3, :3] = rotation_of(world, SLOPE)
    w_T_f[2, 3] = world[FLOOR_Z]
    f_T_c = np.array([values.atPose3(POSE(k)).matrix() for k in range(problem.measurements.count)])
    f_T_c[:, :3, 3] *= np.exp(world[LOG_SCALE])
    return np.asarray(w_T_f @ f_T_c @ np.linalg.inv(problem.b_T_c(values)))
