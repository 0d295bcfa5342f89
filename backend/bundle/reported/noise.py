"""Errors of reported motion, from the stretches of a path that the pictures tell.

The errors of a channel are constants, which a regression finds, white noise, and an error that fades. The
likelihood of a set of noise levels follows from the innovations of a Kalman filter, which here runs for all
levels of a grid at once. It runs on the readings and on the regressors alike, so that the constants follow
from weighted least squares.

Source: Harvey 1989, section 3.4 (likelihood with regressors by the Kalman filter, and its concentration);
Patterson and Thompson 1971 (Biometrika 58) for the part of the likelihood that is free of the constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.bundle.reported.factor import CHANNELS, vector
from backend.bundle.reported.integrate import ReportedInterval
from backend.measurements import ReportedNoise
from backend.triple import triple

Array = NDArray[np.float64]

LEAST_INTERVALS = 20
"""Intervals below which the nominal noise counts."""
_MOST_SECONDS = 0.7
"""Longest interval that tells how errors fade; longer ones are gaps in the pictures."""
_TIMES_S = np.geomspace(0.2, 20.0, 7)
_RATIOS_PER_S = np.geomspace(0.03, 3e4, 13)
"""Variance of the error that fades over the density of the white noise."""
_USUAL_S, _WITHIN = 1.0, 3.0
"""Usual time in which errors fade, and the factor of one standard deviation: a short flight tells little."""
_NO_INFORMATION = 1e-6
"""Information on a constant that has no effect in a flight."""
_LEAST_DENSITY = np.array([1e-3, 1e-3, 1e-4])
"""White noise of perfect instruments, m/s/sqrt(Hz) and rad/s/sqrt(Hz): what a pose of a picture adds."""
_OUTLIER, _ROUNDS, _MOST_OUTLIERS = 4.0, 3, 0.1
"""Innovations that do not count, in standard deviations; rounds in which they are looked for; and the largest
share of them."""


@dataclass(frozen=True)
class Step:
    """An interval with the motion that the pictures show."""

    interval: ReportedInterval
    moved_m: Array
    """(2,) in level axes along the mean heading."""
    turned_rad: float


def identify_reported_noise(steps: Sequence[Step], stamps_s: Array, nominal: ReportedNoise) -> ReportedNoise:
    """Return the noise by steps at the nodes' ``stamps_s`` (m,); the nominal one if the steps are too few."""
    steps = [step for step in steps if step.interval.lasts_s <= _MOST_SECONDS]
    if len(steps) < LEAST_INTERVALS:
        return nominal
    lasts_s = np.array([step.interval.lasts_s for step in steps])
    middle_s = np.array([stamps_s[step.interval.i] for step in steps]) + lasts_s / 2
    found = np.array([_levels(*_series(steps, channel), lasts_s, middle_s) for channel in range(CHANNELS)])
    density, error, time_s = found.T
    density = np.maximum(density, _LEAST_DENSITY)
    return ReportedNoise(*(triple(row) for row in (density, error, time_s)))


def _series(steps: Sequence[Step], channel: int) -> tuple[Array, Array]:
    """Return mean errors (k,) of a channel and the regressors (k, q) of its constants."""
    if channel == CHANNELS - 1:
        errors = [(step.interval.turn_rad - step.turned_rad) / step.interval.lasts_s for step in steps]
        return np.array(errors), np.ones((len(steps), 1))
    rows = [
        [vector(number)[channel] for number in (step.interval.moved, step.interval.by_lag)]
        + [step.moved_m[channel]]
        for step in steps
    ]
    rates = np.array(rows) / np.array([[step.interval.lasts_s] for step in steps])
    return rates[:, 0], np.column_stack([np.ones(len(steps)), rates[:, 1:]])


def _levels(errors: Array, regressors: Array, lasts_s: Array, middle_s: Array) -> tuple[float, float, float]:
    """Return white density, fading error and its time of mean errors (k,)."""
    columns = np.column_stack([errors, regressors])
    grid = [(0.0, 1.0), *((ratio, time_s) for time_s in _TIMES_S for ratio in _RATIOS_PER_S)]
    ratio, time_s = np.array(grid).T
    prior = -((np.log(time_s / _USUAL_S) / np.log(_WITHIN)) ** 2) / 2
    used = np.ones(len(errors), dtype=bool)
    for _ in range(_ROUNDS):
        innovations, spread = _filtered(columns, lasts_s, middle_s, ratio, time_s, used)
        white = innovations / np.sqrt(spread)[..., None]
        count = int(used.sum()) - regressors.shape[1]
        sums = np.einsum("kga,kgb->gab", white[used], white[used])
        constants = np.einsum("gab,gb->ga", np.linalg.pinv(sums[:, 1:, 1:], hermitian=True), sums[:, 1:, 0])
        squares = sums[:, 0, 0] - np.einsum("ga,ga->g", constants, sums[:, 1:, 0])
        variance = np.maximum(squares, 1e-12) / count
        information = np.linalg.slogdet(sums[:, 1:, 1:] + _NO_INFORMATION * np.eye(regressors.shape[1]))[1]
        likelihood = -(count * np.log(variance) + np.log(spread[used]).sum(axis=0) + information) / 2 + prior
        best = int(np.argmax(likelihood))
        left = (white[:, best, 0] - white[:, best, 1:] @ constants[best]) / np.sqrt(variance[best])
        limit = max(_OUTLIER, float(np.quantile(np.abs(left), 1 - _MOST_OUTLIERS)))
        fits = np.abs(left) <= limit
        if (fits == used).all():
            break
        used = fits
    return (
        float(np.sqrt(variance[best])),
        float(np.sqrt(variance[best] * ratio[best])),
        float(time_s[best]),
    )


def _filtered(
    columns: Array,
    lasts_s: Array,
    middle_s: Array,
    ratio: Array,
    time_s: Array,
    used: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Return innovations (k, g, q) of columns (k, q) for each of g noise levels, and their variances (k, g)
    for white noise of unit density."""
    innovations, spread = (
        np.empty((len(columns), len(ratio), columns.shape[1])),
        np.empty((len(columns), len(ratio))),
    )
    mean, variance = np.zeros(innovations.shape[1:]), ratio.copy()
    for k, row in enumerate(columns):
        if k:
            kept = np.exp((middle_s[k - 1] - middle_s[k]) / time_s)
            mean = mean * kept[:, None]
            variance = kept**2 * variance + (1 - kept**2) * ratio
        innovations[k], spread[k] = row - mean, variance + 1 / lasts_s[k]
        if used[k]:
            gain = variance / spread[k]
            mean = mean + gain[:, None] * innovations[k]
            variance = variance * (1 - gain)
    return innovations, spread
