"""Noise and process noise of a signal, from its variogram.

The variogram ``E[(s(t + h) - s(t))^2]`` of a random walk with white noise is ``2 std^2 + power h``. It starts
at twice the variance of the noise and increases with the power of the random walk. Source: Cressie 1993,
Statistics for Spatial Data, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std

Array = NDArray[np.float64]

MARGIN = 2.0
"""Factor on the average power in the recording. Most of the power comes from manoeuvres, and a filter with
too little process noise lags behind. With 8 the standard deviations of simulated flights were 15 % too large
(`tests/benchmarks/simulator.py`)."""
_LONGEST_LAG_S, _LAGS = 1.0, 12
_FAR_MORE = 3.0
"""Factor on the nominal noise above which the start of a variogram is taken as noise."""
_LEAST_POWER = 1e-3
"""Least power, in noise variances per reading, so that the filter can follow some motion."""


@dataclass(frozen=True)
class CorrelatedProcess:
    """An exponentially correlated signal: standard deviation and correlation time."""

    std: float
    time_s: float


def noise_and_power(values: Array, step_s: float, least_std: float) -> tuple[float, float]:
    """Return the white noise of readings (n, d), and the power per second of the true value's random walk;
    NaN does not count.

    The noise is ``least_std``, unless the start of the variogram is far larger. The power is the largest over
    lags up to a second.
    """
    lags = np.unique(np.round(np.geomspace(1, max(2, _LONGEST_LAG_S / step_s), _LAGS)).astype(int))
    lags = lags[[bool(np.isfinite(values[h:] - values[:-h]).any()) for h in lags.tolist()]]
    if len(lags) < 2:
        return least_std, _LEAST_POWER * least_std**2 / step_s
    gamma = np.array([np.nanmean((values[h:] - values[:-h]) ** 2) for h in lags])
    start = max(gamma[0] - (gamma[1] - gamma[0]) * lags[0] / (lags[1] - lags[0]), 0.0)
    white = least_std if start < _FAR_MORE * 2 * least_std**2 else float(np.sqrt(start / 2))
    power = float(np.max((gamma - 2 * white**2) / (lags * step_s)))
    return white, max(power, _LEAST_POWER * white**2 / step_s)


def white_density(stamps_s: Array, values: Array) -> float:
    """Return the density (per root Hz) of white noise in readings (n, d), of the noisiest column.

    It is that of neighbouring readings, vibration included; outliers hardly change it. Of a single reading it
    is infinite.
    """
    known = np.isfinite(values).all(axis=1)
    if known.sum() < 2:
        return float("inf")
    steps = np.diff(values[known], axis=0) / np.sqrt(2)
    std = max(robust_std(column) for column in steps.T)
    return std * float(np.sqrt(np.median(np.diff(np.unique(stamps_s[known])))))


def correlated_process(values: Array, power: float) -> CorrelatedProcess:
    """Return the process of a signal (n, d) with ``power`` at short times and the variance of the signal."""
    variance = MARGIN * max(float(np.nanvar(values, axis=0).max()), power / 2)
    return CorrelatedProcess(float(np.sqrt(variance)), float(2 * variance / (MARGIN * power)))
