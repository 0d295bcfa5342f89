"""Ranges over ground that is not flat: the pictures show how high the ground below each beam is.

A range is the distance to the ground below, and its factor that to the level of the floor. Over steps and
hills the difference would be taken for noise of the ranges, and bend scale and heights. The floor points of
one round therefore continue the ranges of the next one to the level, if they fit it better so.

Only raised points count, the tops of structure. An error of the lens bends the map to a bowl, and ranges that
followed the heights of its points would no longer contradict it.
"""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from backend import se3
from backend.bundle.factors import DATUM, LOG_GAIN, LOG_SCALE, WORLD
from backend.bundle.problem import BundleProblem, Variables

Array = NDArray[np.float64]

_NEAREST, _NEAR = 8, 0.25
"""Floor points whose mean is the height of the ground below a beam, and how far away they are at most, over
the mean height: half of a beam is 0.2 to 0.35 rad wide."""
_LEAST_VIEWS = 2
"""Fewer pictures give a point no height."""
LEAST_RANGES = 4
"""Fewer ranges tell neither their noise nor the ground below: a gain and a zero fit two."""


def level_ranges_m(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Return (r,) what the rangefinder would read of the floor's level where it measured its ranges."""
    world, f_T_s = values.atVector(WORLD), _beams(problem, values)
    return np.asarray(np.exp(world[LOG_GAIN]) * f_T_s[:, 2, 3] / f_T_s[:, 2, 2] + world[DATUM])


def ground_below_m(problem: BundleProblem, at: Variables, height: Array) -> tuple[Array, Array]:
    """Return by how much (r,) the height of the ground below shortens each range, along its beam.

    It is the mean of the nearest floor points, and 0 where none is near; they have a ``height`` (t,) each, in
    units of the map. The second result is the standard deviation (r,) among them.
    """
    scale = float(np.exp(at.values.atVector(WORLD)[LOG_SCALE]))
    seen = np.bincount(problem.tracks.track, minlength=len(at.point)) >= _LEAST_VIEWS
    count = len(problem.measurements.ranges)
    if not seen.any() or not count:
        return np.zeros(count), np.zeros(count)
    f_T_s = _beams(problem, at.values)
    cosine = f_T_s[:, 2, 2]
    foot_m = f_T_s[:, :2, 3] - f_T_s[:, :2, 2] * (f_T_s[:, 2, 3] / cosine)[:, None]
    far, nearest = cKDTree(scale * at.point[seen, :2]).query(
        foot_m, _NEAREST, distance_upper_bound=_NEAR * scale
    )
    near = np.isfinite(far)
    found = np.maximum(near.sum(axis=1), 1)
    height_m = np.append(scale * height[seen], 0.0)[nearest]
    mean_m = height_m.sum(axis=1) / found
    off_m = np.where(near, height_m - mean_m[:, None], 0.0)
    return mean_m / cosine, np.sqrt((off_m**2).sum(axis=1) / found) / cosine


def over_ground(problem: BundleProblem, at: Variables) -> tuple[BundleProblem, float]:
    """Return the problem with ranges over its raised points, at the heights of ``at``, if they fit it better.

    A gain and a zero are free for both, since the scale is not yet that of the better one. The second result
    is the largest change of a range in metres.
    """
    ranges = problem.measurements.ranges
    if len(ranges) < LEAST_RANGES:
        return problem, 0.0
    ground_m = std_m = np.zeros(len(ranges))
    if problem.raised is not None and problem.raised.any():
        below_m = ground_below_m(problem, at, np.where(problem.raised, at.point[:, 2], 0.0))
        level_m = level_ranges_m(problem, at.values)
        heard_m = np.array([r.range_m for r in ranges])
        if _spread_m(level_m, heard_m + below_m[0]) < _spread_m(level_m, heard_m):
            ground_m, std_m = below_m
    over = tuple(
        replace(r, ground_m=by, ground_std_m=std)
        for r, by, std in zip(ranges, ground_m.tolist(), std_m.tolist(), strict=True)
    )
    changed_m = float(np.max(np.abs(ground_m - [r.ground_m for r in ranges])))
    return replace(problem, measurements=replace(problem.measurements, ranges=over)), changed_m


def fit_ground_below(problem: BundleProblem, values: gtsam.Values, within_m: float, share: float) -> bool:
    """Return whether ranges are those of ground off the floor's level, and more than a ``share`` of them fit
    it to ``within_m``."""
    ranges = problem.measurements.ranges
    if not any(r.ground_m for r in ranges):
        return False
    off_m = level_ranges_m(problem, values) - np.array([r.to_level_m for r in ranges])
    return bool(np.mean(np.abs(off_m) <= within_m) > share)


def _beams(problem: BundleProblem, values: gtsam.Values) -> Array:
    """Return (r, 4, 4) the poses of the rangefinder over the floor, in metres."""
    ranges = problem.measurements.ranges
    f_T_c = np.array([values.atPose3(POSE(r.k)).matrix() for r in ranges])
    f_T_c[:, :3, 3] *= np.exp(values.atVector(WORLD)[LOG_SCALE])
    c_T_b = se3.inverse(problem.b_T_c(values))
    return np.asarray(f_T_c @ c_T_b @ np.array([r.b_T_s for r in ranges]))


def _spread_m(level_m: Array, read_m: Array) -> float:
    """Return the robust deviation of readings (r,) from a line over the distances ``level_m`` (r,)."""
    line = np.column_stack([np.ones_like(level_m), level_m])
    off = read_m - line @ np.linalg.lstsq(line, read_m)[0]
    return float(np.median(np.abs(off)))
