"""Planar bundle adjustment: the refinement on the measurements themselves.

A pose graph takes its edges for independent and its attitudes for right. Here each floor point is a variable
seen from all its keyframes, so that nothing is counted twice, and what perspective says about tilt is used.
How much each kind of measurement is to be believed is estimated from its own residuals: attitudes that are
degrees off, a coarse GPS and a floor with relief are found to be so.

Pictures know everything but the scale. So the poses are kept in units of the mean height, the floor at z = 0,
and one variable (`backend.factors`) makes metres of them where a range or a position is compared. Were the
poses in metres, the assumption of a flat floor would pull the whole map to be small.

Source: Triggs et al. 2000 (bundle adjustment); Forstner and Wrobel 2016, section 4.2.4 (variance components).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import L as POINT
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.factors import body_up, scaled_position_factor, scaled_range_factor
from backend.marginals import joint_covariances
from backend.measurements import FloorTracks, Measurements, PinholeModel
from backend.se3 import cross_matrix
from backend.solve import minimise

Array = NDArray[np.float64]
WORLD = gtsam.symbol("w", 0)


@dataclass(frozen=True)
class BundleConfig:
    """How the refinement goes about it."""

    rounds: int = 3
    """Re-estimations of the noise of each kind of measurement."""
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
class Bundle:
    """Refined keyframes."""

    w_T_b: Array
    """(n, 4, 4)."""
    covariances: Array
    """(n, 6, 6), rotation first, right perturbation."""
    floor_z_m: float
    """Of the floor under the origin."""
    floor_slope_rad: tuple[float, float]
    """Rotation vector (x, y) that takes the level to the floor."""
    mean_height_m: float
    focal_px: tuple[float, float]
    radial: tuple[float, float]
    """Radial coefficients (k1, k2) that go with ``focal_px``; zero where they were held."""
    noise: NoiseLevels
    dropped_observations: int
    error: float
    iterations: int


@dataclass(frozen=True)
class _Problem:
    """Everything that stays fixed over a round."""

    measurements: Measurements
    tracks: FloorTracks
    camera: PinholeModel
    config: BundleConfig
    calibrates: bool

    @property
    def c_T_b(self) -> Array:
        return np.linalg.inv(self.camera.b_T_c)


def refine(
    measurements: Measurements,
    w_T_b: Array,
    floor_z_m: float = 0.0,
    config: BundleConfig = BundleConfig(),
    on_step: Callable[[int, float], None] | None = None,
) -> Bundle:
    """Refine one connected set of keyframes, all of them in ``measurements.tracks``.

    ``w_T_b`` (n, 4, 4): a start within the basin of the optimum, such as the pose graph's.
    Raises ``BackendError`` where the problem cannot be solved.
    """
    tracks, camera = measurements.tracks, measurements.camera
    if tracks is None or camera is None:
        raise BackendError(
            "bundle adjustment: no tracks of floor points, or no camera; solve the pose graph alone"
        )
    problem = _Problem(measurements, tracks, camera, config, calibrates=False)
    noise = _start_noise(measurements, config)
    values = _start_values(problem, w_T_b, floor_z_m)
    start = values
    used = np.ones(len(tracks.track), bool)
    iterations = 0
    for number in range(config.rounds):
        if number == 1 and camera.focal_std_ratio > 0:
            # Only now: gtsam's factors with a free calibration forgive points behind the camera, which a
            # start far off would make use of.
            problem = replace(problem, calibrates=True)
            values.insert(CALIBRATION(0), gtsam.Cal3Bundler(camera.focal_px[0], 0, 0, *camera.center_px))
        graph = _build(problem, noise, used, start)
        last = number + 1 == config.rounds
        minimum = minimise(
            graph, values, max_iterations=30, relative_tolerance=1e-5 if last else 1e-3, on_step=on_step
        )
        values, iterations = minimum.values, iterations + minimum.iterations
        if not last:
            noise, used = _estimate_noise(problem, values, noise, used)
    return _result(problem, graph, values, noise, used, minimum.error, iterations)


def _start_noise(measurements: Measurements, config: BundleConfig) -> NoiseLevels:
    """What the makers say, or less."""
    tilt = [a.std_rad[:2].max() for a in measurements.attitudes]
    position = [p.std_m for p in measurements.positions]
    ranges = [r.std_m for r in measurements.ranges]
    return NoiseLevels(
        pixel_scale=1.0,
        relief=config.start_relief,
        roll_pitch_rad=float(np.median(tilt)) if tilt else np.inf,
        position_m=np.median(position, axis=0) if position else np.full(3, np.inf),
        range_m=float(np.median(ranges)) if ranges else np.inf,
    )


def _start_values(problem: _Problem, w_T_b: Array, floor_z_m: float) -> gtsam.Values:
    """Given poses in heights above the floor; each point where its rays meet the floor, on average."""
    tracks, camera = problem.tracks, problem.camera
    w_T_c = w_T_b @ camera.b_T_c
    w_T_c[:, 2, 3] -= floor_z_m
    scale = float(np.median(w_T_c[:, 2, 3]))
    w_T_c[:, :3, 3] /= scale
    values = gtsam.Values()
    for k, pose in enumerate(w_T_c):
        values.insert(POSE(k), gtsam.Pose3(pose))
    pose = w_T_c[tracks.keyframe]
    ray = np.column_stack([(tracks.pixel - camera.center_px) / camera.focal_px, np.ones(len(tracks.pixel))])
    ray = np.einsum("mab,mb->ma", pose[:, :3, :3], ray)
    hit = pose[:, :3, 3] - (pose[:, 2, 3] / np.minimum(ray[:, 2], -1e-3))[:, None] * ray
    seen = np.bincount(tracks.track)
    for t, point in enumerate(
        np.column_stack([np.bincount(tracks.track, hit[:, a]) / seen for a in range(3)])
    ):
        values.insert(POINT(t), point)
    values.insert(WORLD, np.array([np.log(scale), floor_z_m, 0.0, 0.0, 0.0]))
    return values


def _build(
    problem: _Problem, noise: NoiseLevels, used: NDArray[np.bool_], start: gtsam.Values
) -> gtsam.NonlinearFactorGraph:
    """The factor graph at the given noise levels."""
    graph = gtsam.NonlinearFactorGraph()
    _add_observations(graph, problem, noise, used)
    flat = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e4, 1e4, noise.relief]))
    for t in range(int(problem.tracks.track.max()) + 1):
        graph.push_back(gtsam.PriorFactorPoint3(POINT(t), np.zeros(3), flat))
    _add_sensors(graph, problem, noise)
    _add_gauge(graph, problem, start)
    return graph


def _add_observations(
    graph: gtsam.NonlinearFactorGraph, problem: _Problem, noise: NoiseLevels, used: NDArray[np.bool_]
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
            factor = gtsam.GeneralSFMFactor2Cal3Bundler(tracks.pixel[m], models[sigma], *keys, CALIBRATION(0))
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


def _add_sensors(graph: gtsam.NonlinearFactorGraph, problem: _Problem, noise: NoiseLevels) -> None:
    """Attitudes, ranges and positions."""
    measurements, c_T_b = problem.measurements, problem.c_T_b
    up = gtsam.Unit3(np.array([0.0, 0.0, 1.0]))
    if measurements.attitudes:
        model = gtsam.noiseModel.Isotropic.Sigma(2, noise.roll_pitch_rad)
        for a in measurements.attitudes:
            seen_up = gtsam.Unit3(c_T_b[:3, :3] @ body_up(a.roll_pitch_yaw_rad))
            graph.push_back(gtsam.AttitudeFactorPose3(POSE(a.k), up, model, seen_up))
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(1.345)
    if measurements.ranges:
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Isotropic.Sigma(1, noise.range_m))
        for r in measurements.ranges:
            graph.push_back(scaled_range_factor(POSE(r.k), WORLD, r.range_m, model, c_T_b))
    if measurements.positions:
        model = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Diagonal.Sigmas(noise.position_m))
        for p in measurements.positions:
            graph.push_back(scaled_position_factor(POSE(p.k), WORLD, p.w_p_b_m, model, c_T_b))


def _add_gauge(graph: gtsam.NonlinearFactorGraph, problem: _Problem, start: gtsam.Values) -> None:
    """Hold what nothing observes at its start.

    Always the first keyframe's height in the poses' own unit (the scale is a variable of its own); without
    positions its place and heading and the floor's height too; without ranges and positions the scale.
    """
    held, free = 1e-5, 1e3
    placed, scaled = bool(problem.measurements.positions), bool(problem.measurements.ranges)
    first, plane = start.atPose3(POSE(0)), free if placed else held
    place = gtsam.noiseModel.Diagonal.Sigmas(np.array([plane, plane, held]))
    graph.push_back(gtsam.PoseTranslationPrior3D(POSE(0), first, place))
    heading = gtsam.noiseModel.Diagonal.Sigmas(np.array([free, free, plane]))
    graph.push_back(gtsam.PoseRotationPrior3D(POSE(0), first, heading))
    gain = max(problem.measurements.range_gain_std, held)
    slope = problem.config.slope_std_rad if placed else held
    sigmas = [free if placed or scaled else held, 1e5 if placed else held, gain, slope, slope]
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
    graph.push_back(gtsam.PriorFactorVector(WORLD, start.atVector(WORLD), model))


@dataclass(frozen=True)
class _Residuals:
    """Residuals of all kinds at one linearisation point."""

    pixel: Array
    """(m, 2) px."""
    relief: Array
    """(t,) the points' heights over the mean height."""
    relief_information: Array
    """(t,) what the pictures alone say of each point's height, its place projected out."""


def _linearise(problem: _Problem, values: gtsam.Values, std_px: Array, used: NDArray[np.bool_]) -> _Residuals:
    """Residuals, vectorised over all observations."""
    tracks = problem.tracks
    n, points = problem.measurements.count, int(tracks.track.max()) + 1
    pose = np.array([values.atPose3(POSE(k)).matrix() for k in range(n)])[tracks.keyframe]
    point = np.array([values.atPoint3(POINT(t)) for t in range(points)])
    focal, centre, k1, k2 = np.array(problem.camera.focal_px), np.array(problem.camera.center_px), 0.0, 0.0
    if problem.calibrates:
        found = values.atCal3Bundler(CALIBRATION(0))
        focal, k1, k2 = np.full(2, found.fx()), found.k1(), found.k2()
    c_p = np.einsum("mba,mb->ma", pose[:, :3, :3], point[tracks.track] - pose[:, :3, 3])
    xy = c_p[:, :2] / c_p[:, 2:]
    r2 = np.sum(xy**2, axis=1, keepdims=True)
    residual = tracks.pixel - (xy * (1 + k1 * r2 + k2 * r2**2) * focal + centre)
    # d pixel / d point, distortion left out: it is for weights only.
    J = np.zeros((len(c_p), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, :, 2] = -xy
    J = np.einsum("mab,mcb->mac", J * (focal[:, None] / c_p[:, 2, None, None]), pose[:, :3, :3])
    J *= (used / std_px)[:, None, None]
    information = np.zeros((points, 3, 3))
    np.add.at(information, tracks.track, np.einsum("mka,mkb->mab", J, J))
    plane = information[:, :2, :2] + 1e-9 * np.eye(2)
    cross = information[:, :2, 2]
    projected = np.einsum("ta,ta->t", cross, np.linalg.solve(plane, cross[..., None])[..., 0])
    return _Residuals(residual, point[:, 2], np.maximum(information[:, 2, 2] - projected, 0.0))


def _estimate_noise(
    problem: _Problem, values: gtsam.Values, noise: NoiseLevels, used: NDArray[np.bool_]
) -> tuple[NoiseLevels, NDArray[np.bool_]]:
    """Noise levels from the residuals, and which observations to go on with."""
    tracks, measurements = problem.tracks, problem.measurements
    std_px = tracks.std_px * noise.pixel_scale
    residuals = _linearise(problem, values, std_px, used)
    whitened = residuals.pixel / std_px[:, None]
    used = used & (np.linalg.norm(whitened, axis=1) < problem.config.drop_sigmas)
    seen = np.bincount(tracks.track[used], minlength=len(residuals.relief))
    used = used & (seen[tracks.track] >= 2)
    # Each point takes two parameters from the residuals and as much of a third as the relief leaves free.
    free_z = residuals.relief_information / (residuals.relief_information + 1.0 / noise.relief**2)
    spent = 2 * int((seen >= 2).sum()) + float(free_z[seen >= 2].sum()) + 6 * measurements.count
    freedom = max(1.0, 2 * float(used.sum()) - spent)
    spread = huber_std(whitened[used], problem.config.huber_sigmas) * np.sqrt(2 * used.sum() / freedom)
    spread *= np.sqrt(_colour_along_tracks(tracks, whitened, used))
    pixel_scale = noise.pixel_scale * float(np.clip(spread, 0.2, 5.0))
    level = replace(
        noise, pixel_scale=pixel_scale, relief=_estimate_relief(residuals, noise.relief, seen >= 2)
    )
    return _sensor_noise(problem, values, level), used


def _sensor_noise(problem: _Problem, values: gtsam.Values, level: NoiseLevels) -> NoiseLevels:
    """The noise levels with those of attitudes, positions and ranges as their residuals show them."""
    measurements, w_T_b = problem.measurements, _metric_poses(problem, values)
    f_T_c = np.array([values.atPose3(POSE(k)).matrix() for k in range(measurements.count)])
    log_scale, _, log_gain, *_ = values.atVector(WORLD)
    if len(measurements.attitudes) > 2:
        tilt = np.array(
            [np.cross(body_up(a.roll_pitch_yaw_rad), w_T_b[a.k, 2, :3])[:2] for a in measurements.attitudes]
        )
        told = float(np.median([a.std_rad[:2].max() for a in measurements.attitudes]))
        level = replace(level, roll_pitch_rad=max(told, coloured_std(tilt)))
    if len(measurements.positions) > 3:
        off = np.array([p.w_p_b_m - w_T_b[p.k, :3, 3] for p in measurements.positions])
        horizontal, vertical = coloured_std(off[:, :2]), coloured_std(off[:, 2:])
        level = replace(level, position_m=np.array([horizontal, horizontal, vertical]) + 1e-3)
    if len(measurements.ranges) > 3:
        metric = f_T_c.copy()
        metric[:, :3, 3] *= np.exp(log_scale)
        f_T_b = metric @ problem.c_T_b
        seen = np.exp(log_gain) * f_T_b[:, 2, 3] / f_T_b[:, 2, 2]
        off = np.array([seen[r.k] - r.range_m for r in measurements.ranges])
        told = float(np.median([r.std_m for r in measurements.ranges]))
        level = replace(level, range_m=max(told, coloured_std(off[:, None])))
    return level


def _colour_along_tracks(
    tracks: FloorTracks, whitened: Array, used: NDArray[np.bool_], lags: int = 5
) -> float:
    """How many observations of a point count as one: its position errs alike in pictures taken close by.

    Integrated autocorrelation along tracks, less the -1/length that fitting the point puts there.
    """
    m = np.flatnonzero(used)
    m = m[np.lexsort((tracks.keyframe[m], tracks.track[m]))]
    track, residual = tracks.track[m], whitened[m]
    length = np.bincount(track)
    long = length[track] >= 4
    if long.sum() < 100:
        return 1.0
    variance = float(np.mean(residual[long] ** 2))
    total = 1.0
    for lag in range(1, lags + 1):
        pair = (track[lag:] == track[:-lag]) & long[lag:]
        if pair.sum() < 50:
            break
        alike = float(np.mean(residual[lag:][pair] * residual[:-lag][pair])) / variance
        alike += float(np.mean(1.0 / length[track[lag:]][pair]))
        total += 2.0 * max(0.0, alike) * float(pair.sum()) / float(long.sum())
    return total


def _estimate_relief(residuals: _Residuals, start: float, seen: NDArray[np.bool_]) -> float:
    """Standard deviation of the floor's relief: most likely value for heights known to 1/information.

    The height that the pictures alone would give is N(0, relief² + 1/information).
    """
    information = residuals.relief_information
    known = seen & (information * start**2 > 1e-3)
    if known.sum() < 20:
        return start
    information = information[known]
    z = residuals.relief[known] * (1.0 + 1.0 / (information * start**2))
    grid = start * np.geomspace(1e-2, 1e2, 81)
    variance = grid[:, None] ** 2 + 1.0 / information
    # Student-like loss: a few points on walls or wrong matches must not raise the whole floor.
    loss = np.sum(0.5 * np.log(variance) + 2.5 * np.log1p(z**2 / variance / 4.0), axis=1)
    return float(np.clip(grid[np.argmin(loss)], max(0.05 * start, 2e-4), 20 * start))


def huber_std(x: Array, k: float) -> float:
    """Standard deviation of one coordinate of planar residuals (m, 2), tails cut at k: Huber's proposal 2.

    The median would see the core alone, and the estimates that a Huber loss gives would look better than they
    are. Source: Huber and Ronchetti 2009, section 6.4. A Rayleigh distance has
    E[min(d, k)^2] = 2 - 2 exp(-k^2/2).
    """
    distance = np.linalg.norm(x, axis=1)
    sigma = float(np.median(distance)) / 1.1774
    expected = 2.0 * (1.0 - np.exp(-(k**2) / 2))
    for _ in range(30):
        if sigma <= 0:
            break
        sigma *= float(np.sqrt(np.mean(np.minimum(distance / sigma, k) ** 2) / expected))
    return sigma


def coloured_std(x: Array) -> float:
    """What one value of a coloured series (n, d) may claim when all are taken as independent.

    An error that lasts over L keyframes is worth one measurement, not L: its variance is multiplied by the
    integrated autocorrelation. Source: Sokal 1997, section 3 (self-consistent window).
    """
    x = np.asarray(x, dtype=float)
    n = len(x)
    variance = float(np.mean(x**2))
    if variance <= 0 or n < 4:
        return float(np.sqrt(variance))
    total = 1.0
    for lag in range(1, n // 2):
        total += 2 * float(np.mean(np.sum(x[lag:] * x[:-lag], axis=1))) / (x.shape[1] * variance)
        if lag > 5 * total:
            break
    return float(np.sqrt(variance * max(1.0, total)))


def _metric_poses(problem: _Problem, values: gtsam.Values) -> Array:
    """Body poses (n, 4, 4) in metres in the measured world."""
    log_scale, floor_z, _, *slope = values.atVector(WORLD)
    w_T_f = np.eye(4)
    w_T_f[:3, :3] = gtsam.Rot3.Expmap(np.array([*slope, 0.0])).matrix()
    w_T_f[2, 3] = floor_z
    f_T_c = np.array([values.atPose3(POSE(k)).matrix() for k in range(problem.measurements.count)])
    f_T_c[:, :3, 3] *= np.exp(log_scale)
    return np.asarray(w_T_f @ f_T_c @ problem.c_T_b)


def _metric_covariances(problem: _Problem, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Array:
    """(n, 6, 6) of body poses in metres: pose and scale are uncertain together."""
    n, (log_scale, _, _, *slope) = problem.measurements.count, values.atVector(WORLD)
    scale, tilt = float(np.exp(log_scale)), np.array([*slope, 0.0])
    A, turn = gtsam.Rot3.Expmap(tilt).matrix(), gtsam.Rot3.ExpmapDerivative(tilt)[:, :2]
    joint = joint_covariances(graph, values, [POSE(k) for k in range(n)], WORLD)
    adjoint = gtsam.Pose3(problem.camera.b_T_c).AdjointMap()
    covariances = np.empty((n, 6, 6))
    # Without positions the first keyframe is the origin by definition, its height above the floor included.
    origin = np.zeros(3) if problem.measurements.positions else values.atPose3(POSE(0)).translation()
    for k in range(n):
        pose = values.atPose3(POSE(k)).matrix()
        J = np.zeros((6, 11))
        J[:3, :3] = np.eye(3)
        J[3:, 3:6] = scale * np.eye(3)
        R, p = pose[:3, :3], pose[:3, 3] - origin
        J[3:, 6] = scale * R.T @ p
        J[3:, 7] = (A @ R)[2]
        # A right perturbation of the slope turns the whole map about the floor under the origin.
        J[:3, 9:] = R.T @ turn
        J[3:, 9:] = -scale * R.T @ cross_matrix(p) @ turn
        J = adjoint @ J
        covariances[k] = J @ joint[k] @ J.T
    return covariances


def _result(
    problem: _Problem,
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
    log_scale, floor_z, _, *slope = values.atVector(WORLD)
    return Bundle(
        _metric_poses(problem, values),
        _metric_covariances(problem, graph, values),
        float(floor_z),
        (float(slope[0]), float(slope[1])),
        float(np.exp(log_scale)),
        focal,
        radial,
        noise,
        int((~used).sum()),
        error,
        iterations,
    )
