"""Readings that repeat earlier ones of the same stream exactly, at other times.

Noise never repeats. A block of such readings was copied when the file was joined or repaired. A logger that
is faster than its sensor writes each reading several times in a row. Neither is a measurement.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.messages import Message, about
from slam.core.streams import STREAMS

Array = NDArray[np.float64]

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
        arrays = {f.name: getattr(series, f.name) for f in fields(series)}
        kept = {key: a[first] for key, a in arrays.items() if isinstance(a, np.ndarray) and len(a) == count}
        flight = replace(flight, **{name: replace(series, **kept)}).with_warning(
            about(
                STREAMS[name].folder,
                f"{count - len(runs)} of {count} readings only repeat the one before, as a logger writes "
                "that is faster than its sensor",
                "the first of each is kept",
            )
        )
    return flight


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
