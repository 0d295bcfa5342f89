"""The limits that a range sensor states; many drivers leave them 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
Limits = tuple[float, float]


def stated_limits(least_m: Array, most_m: Array) -> Limits | None:
    """Return the medians of the limits in all messages; None where they are no limits."""
    least, most = float(np.median(least_m)), float(np.median(most_m))
    return (least, most) if 0 <= least < most < np.inf else None


def limits_entries(limits: Limits | None) -> dict[str, Value]:
    """Return the keys of ``sensor.yaml``; none for limits that are not stated."""
    return {} if limits is None else {"min_range": repr(limits[0]), "max_range": repr(limits[1])}


def within(range_m: Array, limits: Limits | None) -> NDArray[np.bool_]:
    """Return which ranges (n,) are between the limits; without limits, all that are finite."""
    least, most = limits or (0.0, np.inf)
    return np.asarray((range_m >= least) & (range_m <= most) & np.isfinite(range_m))
