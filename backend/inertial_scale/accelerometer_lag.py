"""The lag of an accelerometer behind the gyro, whose clock the pictures already follow.

A low-pass filter delays the accelerometer's readings, and often by more than those of the gyro. The
displacement that they integrate to then belongs to earlier poses, and the scale absorbs a part of that: 15 ms
change lengths by 1 %. The likelihood of each lag of a grid comes from the regression that gives the scale.
The noise of that regression is a model only, so the spread of the lag between segments decides whether it is
believed, by the jackknife.

Source: Efron and Tibshirani 1993, An Introduction to the Bootstrap, equation 11.5, for the jackknife.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.inertial_scale.regression_rows import PathAndReadings, RegressionRows

Array = NDArray[np.float64]

_PRIOR_STD_S = 0.01
"""Prior deviation of a lag: the filters of common sensors delay by 0 to 19 ms (InvenSense MPU-6000 register
map, register 26)."""
_LONGEST_S = 3 * _PRIOR_STD_S
"""Largest lag of the search."""
_STEP_S = 0.01
"""A parabola through three costs at this distance places the minimum to a hundredth of it."""
_BELIEVED = 16.0
"""Smallest advantage in likelihood, times 2, over no lag at which a lag is believed: four standard
deviations, since a small lag does less harm than a false one."""


@dataclass(frozen=True)
class AccelerometerLag:
    """Delay of the accelerometer's readings behind the gyro's of the same moment."""

    lag_s: float
    std_s: float
    believed: bool
    """Whether no lag is much less likely."""


def accelerometer_lag(
    path: PathAndReadings, fit: Callable[[RegressionRows], Array], noise: Array
) -> AccelerometerLag | None:
    """Estimate the lag; None where the best one lies at the end of the search, or segments contradict it.

    ``fit`` returns the regression's parameters (9,) for the rows of a lag; ``noise`` is as
    `RegressionRows.weight` has it.
    """
    tried_s = np.arange(-_LONGEST_S, _LONGEST_S + _STEP_S / 2, _STEP_S)
    cost = np.array([_cost_by_segment(path, lag_s, fit, noise) for lag_s in tried_s.tolist()])
    whole = cost.sum(axis=1) + (tried_s / _PRIOR_STD_S) ** 2
    best = _lowest(tried_s, whole)
    left_out = [_lowest(tried_s, whole - cost[:, k]) for k in range(cost.shape[1])]
    if best is None or None in left_out:
        return None
    others, count = np.array([lag for lag in left_out if lag])[:, 0], len(left_out)
    between = (count - 1) / count * float(np.sum((others - others.mean()) ** 2))
    lag_s, variance = best
    # Where segments differ by more than the noise implies, the likelihood is as much too sharp. Zero is the
    # middle of the grid; the whole profile counts, since a weak flight has more than one minimum.
    too_sharp = max(1.0, between / variance)
    advantage = float(whole[len(tried_s) // 2] - whole.min()) / too_sharp
    return AccelerometerLag(lag_s, float(np.sqrt(too_sharp * variance)), advantage > _BELIEVED)


def _cost_by_segment(
    path: PathAndReadings, lag_s: float, fit: Callable[[RegressionRows], Array], noise: Array
) -> Array:
    """Return the log-likelihood of a lag, times -2, by segment (s,)."""
    rows = path.rows(lag_s)
    parameters = fit(rows)
    weight = rows.weight(parameters, noise)
    by_row = (weight * rows.residuals(parameters) ** 2 - np.log(weight)).sum(axis=1)
    return np.asarray(np.bincount(rows.segment, by_row, len(path.segments)), dtype=np.float64)


def _lowest(tried_s: Array, cost: Array) -> tuple[float, float] | None:
    """Return minimum and variance by a parabola at the lowest cost; None at an end of the search."""
    k = int(np.argmin(cost))
    if k in (0, len(cost) - 1):
        return None
    before, at, after = cost[k - 1 : k + 2].tolist()
    curvature = (before - 2 * at + after) / _STEP_S**2
    return float(tried_s[k] + 0.5 * (before - after) / _STEP_S / curvature), 2 / curvature
