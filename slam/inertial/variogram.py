"""What a record shows of a signal by itself: the noise of its readings, and how it wanders.

The variogram ``E[(s(t + h) - s(t))^2]`` of white noise on a wandering signal is ``2 std^2 + power h``: it
starts at twice the noise's variance and rises with the signal's power. Source: Cressie 1993, Statistics
for Spatial Data, section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MARGIN = 2.0
"""Signals are taken to wander with this many times the power that the record shows on average: most of it
comes in manoeuvres, and a filter that expects less than comes lags behind. With 8 the standard deviations of
simulated flights were 15 % too large (`tests/benchmarks/simulator.py`)."""
_LONGEST_LAG_S, _LAGS = 1.0, 12
_FAR_MORE = 3.0
"""The start of a variogram is noise where it is this many times what the maker says."""
_LEAST_POWER = 1e-3
"""However still a vehicle was held: a filter that expects no motion at all would not filter_motion any. In
variances of the noise a reading."""


@dataclass(frozen=True)
class Wander:
    """An exponentially correlated signal: how far it goes, and in which time."""

    std: float
    time_s: float


def noise_and_power(values: Array, step_s: float, least_std: float) -> tuple[float, float]:
    """White noise of one reading (n, d), and the power by which the true value wanders, per second.

    The noise is ``least_std`` unless the start of the variogram says that it is far more; the power is the
    largest over lags up to a second.
    """
    lags = np.unique(np.round(np.geomspace(1, max(2, _LONGEST_LAG_S / step_s), _LAGS)).astype(int))
    lags = lags[lags < len(values)]
    if len(lags) < 2:
        return least_std, _LEAST_POWER * least_std**2 / step_s
    gamma = np.array([np.nanmean((values[h:] - values[:-h]) ** 2) for h in lags])
    start = max(gamma[0] - (gamma[1] - gamma[0]) * lags[0] / (lags[1] - lags[0]), 0.0)
    white = least_std if start < _FAR_MORE * 2 * least_std**2 else float(np.sqrt(start / 2))
    power = float(np.max((gamma - 2 * white**2) / (lags * step_s)))
    return white, max(power, _LEAST_POWER * white**2 / step_s)


def wander(values: Array, power: float) -> Wander:
    """Of a signal (n, d) that wanders with ``power`` at short times and goes as far as its own spread."""
    variance = MARGIN * max(float(np.nanvar(values, axis=0).max()), power / 2)
    return Wander(float(np.sqrt(variance)), float(2 * variance / (MARGIN * power)))
