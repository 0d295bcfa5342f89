"""The accuracy that a receiver states of its fixes: of each, and their median as the noise of ``gps0``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Gps

Array = NDArray[np.float64]

_UP_RATIO = Gps.noise_std_m[2] / Gps.noise_std_m[0]
"""Error up over that along the ground, of a receiver that does not state the first."""
_DIFFERENT = 2.0
"""Ratio of standard deviations from which on each fix counts with its own: the weights differ fourfold."""


def with_accuracy(positions: Array, std_m: Array) -> Array:
    """Return rows (n, 6) of ``gps0``: positions (n, 3) and their standard deviations (n, 3) east, north, up.

    What is no positive number is NaN, and so is the accuracy of a row without a position.
    """
    is_stated = np.isfinite(positions[:, :1]) & (std_m > 0)
    return np.hstack([positions, np.where(is_stated, std_m, np.nan)])


def typical_accuracy(std_m: Array) -> tuple[float, float, float] | None:
    """Return the median of the standard deviations (n, 3) that fixes state; None where no fix states those
    along the ground. That of heights is twice as large where none states it."""
    if not np.isfinite(std_m[:, :2]).any(axis=0).all():
        return None
    east_m, north_m = np.nanmedian(std_m[:, :2], axis=0).tolist()
    up_m = float(np.nanmedian(std_m[:, 2])) if np.isfinite(std_m[:, 2]).any() else _UP_RATIO * east_m
    return east_m, north_m, up_m


def median_and_each(std_m: Array) -> tuple[tuple[float, float, float], Array | None]:
    """Return the median of standard deviations (n, 3) of fixes, and all of them if they differ much, as with
    and without RTK."""
    east, north, up = np.median(std_m, axis=0).tolist()
    differ = bool((std_m.max(axis=0) > _DIFFERENT * std_m.min(axis=0)).any())
    return (east, north, up), std_m if differ else None
