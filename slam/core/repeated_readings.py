"""Readings that repeat earlier ones of the same stream exactly, at other times.

Noise never repeats. A block of such readings was copied when the file was joined or repaired. A logger that
is faster than its sensor writes each reading several times in a row. Neither is a measurement.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.instrument import Instrument
from slam.core.messages import Message, about
from slam.core.streams import STREAMS

Array = NDArray[np.float64]
_Series = TypeVar("_Series", bound=Instrument)

_ROWS = 20
"""Successive equal readings that make a block."""
_VARIED = 10
"""Different readings that a block holds at least. A coarse or resting sensor repeats a few; that ten in one
order come twice by chance is excluded for a million readings."""
_FIELDS = {
    "imu": ("gyro_rad_s", "accel_m_s2"),
    "attitude": ("roll_pitch_yaw_rad",),
    "velocity": ("v_m_s",),
    "sonar": ("range_m",),
    "barometer": ("value",),
}


_NEVER_REPEATING = ("imu", "attitude", "velocity")
"""Streams whose repetitions are dropped: a range or a height may be coarse, and repeat by itself."""
_UNSTEADY = 0.4
"""Standard deviation over mean of the lengths of runs. A logger of another rate makes runs of two lengths
that follow each other: at most 1/3. Runs of a coarse reading end by chance: 0.41 and more."""
_CHANCE = 1e-5
"""Probability that two fixes of one place lie so far apart."""


def without_held_readings(flight: Flight) -> Flight:
    """Return the flight with the first of each run of equal readings where most only repeat the one before,
    each a warning.

    The runs of a logger are of about one length, if its sensor does not rest; those of a coarse sensor are
    not.
    """
    for name in _NEVER_REPEATING:
        series = getattr(flight, name)
        if series is None or len(series.stamps_s) < 2 * _ROWS:
            continue
        count = len(series.stamps_s)
        values = np.column_stack([getattr(series, field) for field in _FIELDS[name]])
        first = np.append(True, (values[1:] != values[:-1]).any(axis=1))
        runs = np.diff(np.append(np.flatnonzero(first), count))
        usual = np.median(runs)
        steady = runs[runs <= 2 * usual]
        if len(runs) < _ROWS or usual < 2 or 2 * steady.sum() < count:
            continue
        if steady.std() > _UNSTEADY * steady.mean():
            continue
        flight = replace(flight, **{name: _rows(series, first)}).with_warning(
            about(
                STREAMS[name].folder,
                f"{count - len(runs)} of {count} readings only repeat the one before, as a logger writes "
                "that is faster than its sensor",
                "the first of each is kept",
            )
        )
    return flight


def without_stale_fixes(flight: Flight) -> Flight:
    """Return the flight without fixes that repeat a place which the next other fix shows to be left, and a
    warning of them.

    A receiver that has lost its satellites repeats its last place, and then jumps to where the vehicle is.
    Where it jumps by no more than the errors of two fixes, the vehicle may have stood: those stay.
    """
    gps, origin = flight.gps, flight.geo_origin()
    if gps is None or origin is None:
        return flight
    place = np.column_stack([gps.latitude_deg, gps.longitude_deg])
    first = np.append(True, (place[1:] != place[:-1]).any(axis=1))
    begin = np.flatnonzero(first)
    w_p_m = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, np.nan, origin)[begin, :2]
    variance_m2 = gps.each_std_m[begin, :2] ** 2
    jump = np.sum(np.diff(w_p_m, axis=0) ** 2 / (variance_m2[1:] + variance_m2[:-1]), axis=1)
    left = np.append(jump > chi_square_limit(_CHANCE, 2), False)
    stale = ~first & left[np.cumsum(first) - 1]
    if not stale.any():
        return flight
    at_s = gps.stamps_s[stale]
    return replace(flight, gps=_rows(gps, ~stale)).with_warning(
        about(
            STREAMS["gps"].folder,
            f"{stale.sum()} of {len(stale)} fixes, from {at_s[0]:.1f} to {at_s[-1]:.1f} s, repeat the place "
            "before to the last digit, and the next one is elsewhere, as of a receiver without satellites",
            "the first of each is kept",
        )
    )


def _rows(series: _Series, kept: NDArray[np.bool_]) -> _Series:
    """Return the rows of a stream that are ``kept`` (n,)."""
    arrays = {each.name: getattr(series, each.name) for each in fields(series)}
    rows: dict[str, Any] = {
        name: a[kept] for name, a in arrays.items() if isinstance(a, np.ndarray) and len(a) == len(kept)
    }
    return replace(series, **rows)


def repeated_readings(flight: Flight) -> list[Message]:
    """Return a line for each stream in which a block of readings repeats an earlier one."""
    lines = []
    for name, columns in _FIELDS.items():
        series = getattr(flight, name)
        if series is None:
            continue
        block = _longest_copy(np.column_stack([getattr(series, column) for column in columns]))
        if block is not None:
            first, earlier, count = block
            at_s = series.stamps_s[[first, first + count - 1, earlier, earlier + count - 1]]
            lines.append(
                about(
                    STREAMS[name].folder,
                    f"its readings from {at_s[0]:.1f} to {at_s[1]:.1f} s repeat exactly those "
                    f"from {at_s[2]:.1f} to {at_s[3]:.1f} s, which no sensor does: remove the copied rows",
                )
            )
    return lines


def _longest_copy(values: Array) -> tuple[int, int, int] | None:
    """Return the first row of the longest copied block of values (n, d), that of its original, and the number
    of rows; None without one."""
    if len(values) < 2 * _ROWS:
        return None
    reading = np.unique(values, axis=0, return_inverse=True)[1].reshape(-1)
    weights = np.random.default_rng(0).integers(1, 2**62, _ROWS)  # a hash; sums may overflow
    windows = sliding_window_view(reading, _ROWS)
    _, original, number = np.unique(windows @ weights, return_index=True, return_inverse=True)
    back = np.arange(len(windows)) - original[number.reshape(-1)]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(back)) + 1, [len(back)]])
    for k in np.argsort(-np.diff(edges), kind="stable").tolist():
        first, count = int(edges[k]), int(edges[k + 1] - edges[k]) + _ROWS - 1
        shift = int(back[first])
        # A copy lies behind its original; nearer ones are a sensor that sticks.
        if shift >= _ROWS and len(np.unique(reading[first : first + count])) >= _VARIED:
            return first, first - shift, count
    return None
