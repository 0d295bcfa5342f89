"""Variance components: noise levels of each kind of measurement from the refinement's residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from backend.bundle.barometer import HEIGHTS, height_residuals
from backend.bundle.control import mark_residuals, survey_residuals
from backend.bundle.factors import ANTENNA, OFFSET, WORLD, body_up
from backend.bundle.free_points import FreePoints
from backend.bundle.ground_below import level_ranges_m
from backend.bundle.metric_poses import metric_poses
from backend.bundle.minimise import BundleOptimum
from backend.bundle.noise_level import (
    least_std,
    over_typical,
    pooled,
    positions_over_typical,
    redundancy_factor,
)
from backend.bundle.observations import Cameras, FloorObservations, height_stds
from backend.bundle.position_redundancy import absorbed_positions
from backend.bundle.problem import BundleConfig, BundleProblem, NoiseLevels
from backend.bundle.relief import LEAST_PICTURES, find_heights
from backend.bundle.residual_spread import huber_std, robust_autocorrelated_std
from backend.measurements import FloorTracks, Measurements, SlantRange
from backend.quantiles import chi_square_quantile
from backend.robust import huber_limit

Array = NDArray[np.float64]

_MAX_LAG = 5
"""Largest lag of the autocorrelation along a track, in keyframes."""
_MIN_PIXEL_SCALE = 0.01
"""Lower limit of the pixel scale: pictures without noise would reduce it to zero over the rounds."""
TOLERANCE = 0.15
"""Relative difference below which noise levels count as equal: just above the spacing of tried reliefs."""
_SIMILARITY = 7.0
"""Degrees of freedom by which control points place a map: position, attitude and scale."""


def start_noise(measurements: Measurements, config: BundleConfig) -> NoiseLevels:
    """Return nominal noise levels, the median over the keyframes; infinite for an absent instrument."""
    tilt = [a.std_rad[:2].max() for a in measurements.attitudes]
    ranges, heights = ([m.std_m for m in kind] for kind in (measurements.ranges, measurements.heights))
    return NoiseLevels(
        pixel_scale=1.0,
        relief=config.start_relief,
        slope_rad=config.slope_std_rad,
        roll_pitch_rad=float(np.median(tilt)) if tilt else np.inf,
        position_m=_stated_position_noise(measurements),
        range_m=float(np.median(ranges)) if ranges else np.inf,
        height_m=float(np.median(heights)) if heights else np.inf,
    )


def _stated_position_noise(measurements: Measurements) -> Array:
    stated = np.array([p.std_m for p in measurements.positions]).reshape(-1, 3)
    return np.array([_median_of_finite(axis) for axis in stated.T])


def _median_of_finite(x: Array) -> float:
    x = x[np.isfinite(x)]
    return float(np.median(x)) if len(x) else np.inf


def same_noise(one: NoiseLevels, other: NoiseLevels) -> bool:
    """Return whether two sets of noise levels agree within the tolerance."""
    return all(
        np.allclose(getattr(one, f.name), getattr(other, f.name), TOLERANCE) for f in fields(NoiseLevels)
    )


@dataclass(frozen=True)
class Estimated:
    """Noise levels, observations and points for the next round, as the residuals of one show them."""

    noise: NoiseLevels
    used: NDArray[np.bool_]
    """(m,) observations to keep."""
    raised: NDArray[np.bool_]
    """(t,) floor points that stand above the ground."""
    point: Array
    """(t, 3) all points; those are at heights of their own."""


def estimate_noise(optimum: BundleOptimum, level: bool = True) -> Estimated:
    """Return noise levels from the residuals, the observations to keep, and the points above the ground.

    ``level``: whether the fit has the ground at height zero.
    """
    problem, at, noise, used = optimum.problem, optimum.at, optimum.noise, optimum.used
    tracks, config = problem.tracks, problem.config
    sensors = _sensor_noise(problem, at.values, noise, absorbed_positions(optimum))
    if len(tracks.track) == 0:
        return Estimated(sensors, used, np.zeros(0, bool), at.point)
    # Dropped observations too: a height of its own may explain them.
    every = FloorObservations.of(problem, noise, np.ones(len(used), bool))
    cameras, whitened = Cameras.of(problem, at.values), np.empty_like(tracks.pixel)
    whitened[every.number] = every.whitened(cameras, at.point)
    # Outlier limits use the estimated noise if it is larger: the nominal one may be far too small.
    spread = huber_std(_evened(tracks.track[used], whitened[used]), config.huber_sigmas)
    free = FreePoints.of(every, cameras, at.point, config.drop_sigmas * max(1.0, spread))
    heights = find_heights(free, np.bincount(tracks.track[used], minlength=len(at.point)), noise, level)
    raised = heights.raised
    point = np.where(raised[:, None], free.point, at.point)
    if raised.any() or heights.doubtful.any():
        whitened[every.number] = every.whitened(cameras, point)
        used = (used | raised[tracks.track]) & ~heights.doubtful[tracks.track]
    levels = replace(
        sensors, relief=heights.relief, relief_inflation=heights.inflation, structure=heights.structure
    )
    fitted_std = np.where(raised, heights.structure, every.prior_std[:, 2])
    fit = _Fit(whitened, tracks.track, free.information, fitted_std, problem.measurements.count)
    spread = fit.spread(used, fitted_std, config.huber_sigmas)
    used = used & (np.linalg.norm(whitened, axis=1) < config.drop_sigmas * max(1.0, spread))
    pictures = np.bincount(tracks.track[used], minlength=len(point))
    used = used & (pictures[tracks.track] >= 2)
    raised = raised & (pictures >= LEAST_PICTURES)
    spread = fit.spread(used, height_stds(raised, levels), config.huber_sigmas)
    spread *= np.sqrt(track_correlation_factor(tracks, whitened, used))
    pixel_scale = max(noise.pixel_scale * float(np.clip(spread, 0.2, 5.0)), _MIN_PIXEL_SCALE)
    return Estimated(replace(levels, pixel_scale=pixel_scale), used, raised, point)


def _evened(track: NDArray[np.int64], whitened: Array) -> Array:
    """Return whitened residuals (m, 2) over the share that the fit of each point leaves of them.

    It absorbs half with two pictures. Without this, a mixture of variances would look heavy-tailed.
    """
    pictures = np.bincount(track)
    return np.asarray(whitened * np.sqrt(pictures / np.maximum(pictures - 1, 1))[track][:, None])


@dataclass(frozen=True)
class _Fit:
    """Residuals of all observations, and the freedom of the fit that they are of."""

    whitened: Array
    """(m, 2)."""
    track: NDArray[np.int64]
    """(m,)."""
    information: Array
    """(t,) of the pictures alone on each point's height."""
    height_std: Array
    """(t,) deviation of the prior on it in the fit."""
    poses: int

    def spread(self, used: NDArray[np.bool_], height_std: Array, huber_sigmas: float) -> float:
        """Return the standard deviation of the whitened pixel noise, corrected for degrees of freedom.

        ``height_std`` (t,) is the current estimate of the deviations of the heights.
        """
        pictures = np.bincount(self.track[used], minlength=len(height_std))
        # Each pose absorbs six degrees of freedom. A height absorbs the share that its prior in the fit
        # allows; the estimate of the prior gives the variance of what remains.
        shrunk = 1.0 / (1.0 + self.information * self.height_std**2)
        left_z = shrunk**2 * (1.0 + self.information * height_std**2)
        left = 2 * float((pictures[pictures >= 2] - 1).sum())
        dof = max(1.0, left - float((1.0 - left_z)[pictures >= 2].sum()) - 6 * self.poses)
        evened = _evened(self.track[used], self.whitened[used])
        return huber_std(evened, huber_sigmas) * float(np.sqrt(left / dof))


def _sensor_noise(
    problem: BundleProblem, values: gtsam.Values, level: NoiseLevels, absorbed: Array
) -> NoiseLevels:
    """Return the noise levels with those of the instruments from their residuals."""
    measurements, w_T_b = problem.measurements, metric_poses(problem, values)
    world = values.atVector(WORLD)
    if len(measurements.attitudes) > 2:
        tilt = np.array(
            [np.cross(body_up(a.roll_pitch_yaw_rad), w_T_b[a.k, 2, :3])[:2] for a in measurements.attitudes]
        )
        stated = [a.std_rad[:2].max() for a in measurements.attitudes]
        level = replace(level, roll_pitch_rad=_pooled(stated, tilt))
    if len(measurements.positions) > 3:
        position_m = _position_noise(measurements, w_T_b, world, level.position_m, absorbed)
        level = replace(level, position_m=position_m)
    if len(measurements.control) > 3:
        cameras, points = Cameras.of(problem, values), measurements.control
        marks = mark_residuals(points, values, cameras.f_T_c, cameras.calibration, problem.exposure_motion)
        level = replace(
            level,
            control=_survey_scale(survey_residuals(points, values)),
            marks=_mark_scale(marks, len(points)),
        )
    if len(measurements.ranges) > 3:
        off = level_ranges_m(problem, values) - np.array([r.to_level_m for r in measurements.ranges])
        level = replace(level, range_m=range_noise(measurements.ranges, off))
    if len(measurements.heights) > 3:
        off = height_residuals(measurements.heights, w_T_b, values.atVector(HEIGHTS))
        level = replace(level, height_m=_pooled([h.std_m for h in measurements.heights], off[:, None]))
    return level


def range_noise(ranges: Sequence[SlantRange], off: Array) -> float:
    """Return the noise of a typical range from the residuals ``off`` (n,) of some."""
    return _pooled([r.to_level_std_m for r in ranges], off[:, None])


def _pooled(stated: Sequence[float], off: Array) -> float:
    """Return the noise of a typical reading, from the stated deviations (n,) and the residuals (n, d)."""
    even = off / over_typical(stated)[:, None]
    return pooled(float(np.median(stated)), robust_autocorrelated_std(even), len(off))


def _position_noise(
    measurements: Measurements, w_T_b: Array, world: Array, before: Array, absorbed: Array
) -> Array:
    """Return the standard deviations east, north, up of positions, those ``before`` where too few have them.

    East and north have one factor on what the receiver states of each.
    """
    w_p_a = w_T_b[:, :3, 3] + w_T_b[:, :3, :3] @ world[ANTENNA] + world[OFFSET]
    over, stated = positions_over_typical(measurements.positions), _stated_position_noise(measurements)
    measured = np.isfinite([p.std_m for p in measurements.positions])
    off = np.array([p.w_p_antenna_m - w_p_a[p.k] for p in measurements.positions])
    noise = before.copy()
    for axes in (slice(0, 2), slice(2, 3)):
        rows = measured[:, axes].all(axis=1)
        if rows.sum() <= 3:
            continue
        whitened = (off / over)[rows, axes] / stated[axes]
        found = robust_autocorrelated_std(whitened) * redundancy_factor(whitened.size, absorbed[axes])
        least = 1.0
        # Residuals below the stated accuracy count, as far as they can show it. Where fixes differ, many
        # coarse ones that are better than they state would say so of the fine ones too.
        if over[:, axes].max() < 1 + 1e-6:  # interpolation between fixes rounds
            factor = float(np.mean(before[axes] / stated[axes]))
            least = min(least, least_std(factor, whitened.size, absorbed[axes]))
        noise[axes] = max(found, least) * stated[axes]
    return noise


def _survey_scale(off: Array) -> float:
    """Return the factor on the stated deviations of control points from whitened residuals (n, 3).

    The median counts: of few points one that is wrong would raise any mean, and then bend the map.
    """
    median = float(np.median(np.linalg.norm(off, axis=1)) / np.sqrt(chi_square_quantile(0.5, 3)))
    found = median * redundancy_factor(off.size, np.array([_SIMILARITY]))
    return max(1.0, pooled(1.0, found, off.size))


def _mark_scale(off: Array, points: int) -> float:
    """Return the factor on the deviations of pixels of ``points`` from whitened residuals (m, 2).

    Each point absorbs three of them.
    """
    left = off.size - 3 * points
    if left <= 3:
        return 1.0
    found = huber_std(off, huber_limit(off.shape[1])) * redundancy_factor(off.size, np.array([3.0 * points]))
    return pooled(1.0, found, left)


def track_correlation_factor(tracks: FloorTracks, whitened: Array, used: NDArray[np.bool_]) -> float:
    """Return the number of observations per independent one: errors in successive pictures are correlated.

    It is the integrated autocorrelation of the residuals along tracks, corrected for the -1/length that the
    fit of the point induces.
    """
    m = np.flatnonzero(used)
    m = m[np.lexsort((tracks.keyframe[m], tracks.track[m]))]
    track, residual = tracks.track[m], whitened[m]
    length = np.bincount(track)
    long = length[track] >= 4
    if long.sum() < 100:
        return 1.0
    variance = float(np.mean(residual[long] ** 2))
    excess, chance = 0.0, 0.0
    for lag in range(1, _MAX_LAG + 1):
        pair = (track[lag:] == track[:-lag]) & long[lag:]
        if pair.sum() < 50:
            break
        alike = float(np.mean(residual[lag:][pair] * residual[:-lag][pair])) / variance
        alike += float(np.mean(1.0 / length[track[lag:]][pair]))
        share = float(pair.sum()) / float(long.sum())
        excess += 2.0 * max(0.0, alike) * share
        chance += (2.0 * share) ** 2 / (2 * float(pair.sum()))
    # Independent errors are slightly correlated by chance.
    return 1.0 + excess if excess > 2.0 * np.sqrt(chance) else 1.0
