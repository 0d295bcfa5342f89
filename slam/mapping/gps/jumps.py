"""Jumps of the GPS fixes against the map, between successive fixes that the map uses.

The errors of satellite positions change slowly, so that the differences between successive residuals are
smaller than the residuals. A jump that a wrong scale and heading of the map hide in the residuals stands out
of these differences.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import f_limit
from backend.significance import FALSE_ALARM
from slam.mapping.gps.consensus import MEDIAN_OF_RAYLEIGH, nominal_limit_m

Array = NDArray[np.float64]

LEAST_STEPS = 6


def jumps(off_m: Array, nominal_std_m: tuple[float, float, float]) -> NDArray[np.int64]:
    """Return the rows (k,) of the fixes before which the horizontal residuals ``off_m`` (n, 2) jump.

    No jump is within the nominal standard deviations.
    """
    steps_m = np.diff(off_m, axis=0)
    n = len(steps_m)
    if n < LEAST_STEPS:
        return np.zeros(0, np.int64)
    # Along one line a wrong scale or heading adds the same to all steps.
    step_m = np.linalg.norm(steps_m - np.median(steps_m, axis=0), axis=1)
    std_m = float(np.median(step_m)) / MEDIAN_OF_RAYLEIGH
    limit_m = std_m * np.sqrt(2 * f_limit(FALSE_ALARM / n, 2, n))
    nominal_m = np.sqrt(2) * nominal_limit_m(nominal_std_m)  # of a difference between two fixes
    return 1 + np.flatnonzero(step_m > max(limit_m, nominal_m))
