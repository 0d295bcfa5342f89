"""How well the sampling of a gyro determines when the vehicle turned.

Between two readings the rate is taken as linear. That is right for a smooth motion. A rate that jumps, as
where a controller changes its commands, jumps anywhere between two readings. A controller that runs on the
clock of the gyro makes all jumps at the same share of the interval, so that the integral of the readings is
early or late by up to half of it over the whole flight. No comparison of parts of the flight shows that.

The variogram ``E[|rate(t + h) - rate(t)|²]`` tells jumps from a smooth motion: at short lags it increases
with ``h`` for the former and with ``h²`` for the latter. White noise adds a constant.

Source: Cressie 1993, Statistics for Spatial Data, section 2.3, for the variogram near zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.measurements import InertialReadings

Array = NDArray[np.float64]

_LAGS = np.arange(1, 7)
"""Lags in readings: twice as many as the numbers that they determine."""


def sampling_std_s(readings: InertialReadings, turn_s: float) -> float:
    """Return the standard deviation of the delay of a gyro's integral that its sampling leaves open.

    It is that of a uniform distribution over one interval between readings, times the share of the change of
    the rate over ``turn_s`` seconds, the duration of a turn, that comes in jumps. The share is 0 for fewer
    readings than the variogram needs.
    """
    step_s = float(np.median(np.diff(readings.stamps_s))) if len(readings.stamps_s) > 1 else 0.0
    over = max(round(turn_s / step_s), 1) if step_s > 0 else 1
    if step_s <= 0 or len(readings.stamps_s) <= max(over, _LAGS[-1]):
        return 0.0
    near_zero = [_variogram(readings, lag) for lag in _LAGS.tolist()]
    terms = np.column_stack([np.ones(len(_LAGS)), _LAGS, _LAGS**2])
    noise, in_jumps, _ = np.linalg.lstsq(terms, near_zero, rcond=None)[0].tolist()
    changed = _variogram(readings, over) - noise
    share = np.clip(in_jumps * over / changed, 0.0, 1.0) if changed > 0 else 0.0
    return float(share * step_s / np.sqrt(12.0))


def _variogram(readings: InertialReadings, lag: int) -> float:
    """Return the mean square of the change of the rate over ``lag`` readings."""
    change = readings.gyro_rad_s[lag:] - readings.gyro_rad_s[:-lag]
    return float((change**2).sum(axis=1).mean())
