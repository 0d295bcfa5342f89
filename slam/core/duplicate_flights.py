"""Detection of recordings that are given twice: a copy adds no information and would be counted as new."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from slam.core.flight import Flight

NOISY_STREAMS = ("imu", "attitude", "velocity", "sonar", "gps")
"""Streams whose noise never repeats. Commands of one script do repeat, and so may the coarse readings of a
battery, a barometer or a motor."""
MIN_READINGS = 10
"""So many readings do not agree to the last digit by chance."""


def without_duplicates(flights: Sequence[Flight]) -> tuple[list[Flight], list[str]]:
    """Return the flights without copies of an earlier one, and one line for each copy."""
    kept: list[Flight] = []
    notes = []
    for flight in flights:
        first = next((other for other in kept if same_recording(other, flight)), None)
        if first is None:
            kept.append(flight)
        else:
            notes.append(f"{flight.name}: the same recording as {first.name}; it was left out")
    return kept, notes


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
