"""The accuracy that a receiver states of its fixes: of each, and their median as the noise of ``gps0``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slam.core.geodesy import MAX_ALTITUDE_M, METRES_PER_DEGREE, metres_per_degree_east
from slam.core.messages import Message, warning
from slam.core.streams import Gps

Array = NDArray[np.float64]

_UP_RATIO = Gps.noise_std_m[2] / Gps.noise_std_m[0]
"""Error up over that along the ground, of a receiver that does not state the first."""
_DIFFERENT = 2.0
"""Ratio of standard deviations from which on each fix counts with its own: the weights differ fourfold."""
_FINEST_M = 1e-3
"""No receiver states its accuracy finer: this many degrees, 111 m, may be as many metres."""
_UP_SPLIT = _UP_RATIO * METRES_PER_DEGREE**0.5
"""Error up in metres over a number for that along the ground, halfway in digits between one in metres and one
in degrees."""


def accuracy_in_metres(
    noise_std: Sequence[float], latitude_deg: float, notes: list[Message]
) -> tuple[float, float, float]:
    """Return the accuracy east, north, up in metres of ``noise_std``: along latitude, longitude, and up.

    It is in degrees, degrees and metres. Numbers of 0.001 or more are taken as metres, with a note, unless
    the accuracy of the altitude fits to degrees: 111 m or worse.
    """
    north, east, up = noise_std
    along = max(north, east)
    in_degrees = east * metres_per_degree_east(latitude_deg), north * METRES_PER_DEGREE
    if along < _FINEST_M:
        return *in_degrees, up
    what = f"noise_std of latitude and longitude, {along:.4g}, is taken as"
    degrees = f"{along / METRES_PER_DEGREE:.3g}"
    if up > _UP_SPLIT * along:
        why = f"{max(in_degrees):.0f} m, because that of the altitude is {up:g} m"
        notes.append(warning(f"{what} degrees, {why}", f"write {degrees} if it is in metres"))
        return *in_degrees, up
    notes.append(
        warning(f"{what} metres: as degrees it is {max(in_degrees):.0f} m", f"write degrees, {degrees}")
    )
    return east, north, up


def with_accuracy(positions: Array, std_m: Array) -> Array:
    """Return rows (n, 6) of ``gps0``: positions (n, 3) and their standard deviations (n, 3) east, north, up.

    What is no possible accuracy is NaN, such as 0 or the largest integer, and so is that of a row without a
    position.
    """
    is_stated = np.isfinite(positions[:, :1]) & (std_m > 0) & (std_m < MAX_ALTITUDE_M)
    return np.hstack([positions, np.where(is_stated, std_m, np.nan)])


def stated_stds(rows: Array) -> Array:
    """Return the standard deviations (n, 3) that rows (n, 3 to 6) of ``gps0`` state; NaN without one."""
    stated_m = np.full((len(rows), 3), np.nan)
    stated_m[:, : rows.shape[1] - 3] = np.where(rows[:, 3:] > 0, rows[:, 3:], np.nan)
    return stated_m


def typical_accuracy(std_m: Array) -> tuple[float, float, float] | None:
    """Return the median of the standard deviations (n, 3) that fixes state; None where no fix states those
    along the ground. That of heights is twice as large where none states it."""
    if not np.isfinite(std_m[:, :2]).any(axis=0).all():
        return None
    east_m, north_m = np.nanmedian(std_m[:, :2], axis=0).tolist()
    up_m = float(np.nanmedian(std_m[:, 2])) if np.isfinite(std_m[:, 2]).any() else _UP_RATIO * east_m
    return east_m, north_m, up_m


def median_and_each(
    std_m: Array, otherwise_m: tuple[float, float, float]
) -> tuple[tuple[float, float, float], Array | None]:
    """Return the median of standard deviations (n, 3) of fixes, and all of them if they differ much, as with
    and without RTK. ``otherwise_m`` is that of fixes that state none, and the median where no fix does."""
    if typical_accuracy(std_m) is None:
        return otherwise_m, None
    each_m = np.where(np.isfinite(std_m), std_m, otherwise_m)
    east, north, up = np.median(each_m, axis=0).tolist()
    differ = bool((each_m.max(axis=0) > _DIFFERENT * each_m.min(axis=0)).any())
    return (east, north, up), each_m if differ else None
