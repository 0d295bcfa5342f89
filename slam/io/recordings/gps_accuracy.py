"""The accuracy that a receiver states of its positions, as the nominal noise of ``gps0``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Gps
from slam.core.geodesy import METRES_PER_DEGREE, metres_per_degree_east
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]

_UP_RATIO = Gps.noise_std_m[2] / Gps.noise_std_m[0]
"""Error up over that along the ground, of a receiver that does not state the first."""


def gps_noise(latitude_deg: Array, std_m: Array) -> dict[str, Value]:
    """Return ``noise_std`` from the stated standard deviations (n, 3) east, north, up [m] of positions.

    Rows without a position, and values that are no positive number, say nothing. Nothing is returned where
    the errors along the ground are not stated. Up alone is then taken as twice as large.
    """
    told = np.where(np.isfinite(latitude_deg)[:, None] & (std_m > 0), std_m, np.nan)
    if not np.isfinite(told[:, :2]).any(axis=0).all():
        return {}
    east_m, north_m = (float(np.nanmedian(column)) for column in told.T[:2])
    up_m = float(np.nanmedian(told[:, 2])) if np.isfinite(told[:, 2]).any() else _UP_RATIO * east_m
    east_deg = east_m / metres_per_degree_east(float(np.nanmedian(latitude_deg)))
    return {"noise_std": [repr(v) for v in (north_m / METRES_PER_DEGREE, east_deg, up_m)]}
