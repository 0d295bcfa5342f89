"""Detection of recordings that are given twice, or in part: a copy adds no information, and would be counted
as new."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.messages import Message, warning

NOISY_STREAMS = ("imu", "attitude", "velocity", "sonar", "gps")
"""Streams whose noise never repeats. Commands of one script do repeat, and so may the coarse readings of a
battery, a barometer or a motor."""
MIN_READINGS = 10
"""So many readings do not agree to the last digit by chance."""
ALL_BUT = 0.1
"""Greatest share of two cuts' common readings that differ: those at the edges may be cut or averaged."""


def without_duplicates(flights: Sequence[Flight]) -> tuple[list[Flight], list[str]]:
    """Return the flights without copies of an earlier one, and what each copy is."""
    kept: list[Flight] = []
    copies = []
    for flight in flights:
        first = next((other for other in kept if same_recording(other, flight)), None)
        if first is None:
            kept.append(flight)
        else:
            copies.append(f"{flight.name}: the same recording as {first.name}")
    return kept, copies


def without_overlaps(flights: Sequence[Flight]) -> tuple[list[Flight], list[Message]]:
    """Return the flights without copies of an earlier one, and without cuts that share readings with one; and
    a line for each that was left out."""
    kept, found = without_duplicates(flights)
    apart: list[Flight] = []
    for flight in kept:
        common = ((shared_s(other, flight), other.name) for other in apart)
        most_s, name = max(common, default=(0.0, ""))
        if most_s == 0.0:
            apart.append(flight)
        else:
            found.append(f"{flight.name}: {most_s:.1f} s of its readings are in {name} too")
    return apart, [warning(finding, "it was left out") for finding in found]


def shared_s(a: Flight, b: Flight) -> float:
    """Return for how many seconds noisy streams of two flights have the same readings to the last digit,
    whatever their stamps."""
    return max(_shared_s(getattr(a, name), getattr(b, name)) for name in NOISY_STREAMS)


def _shared_s(a: Any, b: Any) -> float:
    if a is None or b is None:
        return 0.0
    one, other = _readings(a), _readings(b)
    if one.shape[1] != other.shape[1] or not one.size:
        return 0.0
    # Readings that are met once in each, and by how many readings the second flight begins later.
    (rows, at), (others, other_at) = map(_met_once, (one, other))
    _, same_row, same_other = np.intersect1d(rows, others, assume_unique=True, return_indices=True)
    later = at[same_row] - other_at[same_other]
    if len(later) < MIN_READINGS:
        return 0.0
    values, counts = np.unique(later, return_counts=True)
    shift, count = int(values[np.argmax(counts)]), int(counts.max())
    begin, end = max(shift, 0), min(len(one), len(other) + shift)
    same = (one[begin:end] == other[begin - shift : end - shift]).all(axis=1)
    if count < MIN_READINGS or np.mean(~same) > ALL_BUT:
        return 0.0
    return float(a.stamps_s[end - 1] - a.stamps_s[begin])


def _met_once(readings: NDArray[np.float64]) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Return the bytes of each of the readings (n, k) that is met once, and its place among them."""
    as_bytes = np.ascontiguousarray(readings).view((np.void, readings.itemsize * readings.shape[1])).ravel()
    rows, at, counts = np.unique(as_bytes, return_index=True, return_counts=True)
    once = (counts == 1) & np.isfinite(readings[at]).any(axis=1)
    return rows[once], at[once]


def _readings(stream: Any) -> NDArray[np.float64]:
    """Return (n, k) all numbers of a stream's readings but their stamps; infinite where one is missing."""
    count, tables = len(stream.stamps_s), []
    for field in (f for f in fields(stream) if f.name != "stamps_s"):
        values = np.asarray(getattr(stream, field.name))
        if count and values.shape[:1] == (count,) and values.dtype.kind == "f":
            tables.append(values.reshape(count, -1))
    readings = np.column_stack([np.zeros((count, 0)), *tables])
    return np.where(np.isnan(readings), np.inf, readings)


def same_recording(a: Flight, b: Flight) -> bool:
    """Return whether a noisy stream has the same readings in both flights, to the last digit."""
    return any(_equal_streams(getattr(a, name), getattr(b, name)) for name in NOISY_STREAMS)


def _equal_streams(a: Any, b: Any) -> bool:
    if a is None or b is None or not np.array_equal(a.stamps_s, b.stamps_s) or len(a.stamps_s) < MIN_READINGS:
        return False
    count = len(a.stamps_s)
    names = [
        f.name for f in fields(a) if f.name != "stamps_s" and np.shape(getattr(a, f.name))[:1] == (count,)
    ]
    arrays = [(np.asarray(getattr(a, name)), np.asarray(getattr(b, name))) for name in names]
    return any(np.isfinite(x).any() for x, _ in arrays) and all(
        np.array_equal(x, y, equal_nan=True) for x, y in arrays
    )
