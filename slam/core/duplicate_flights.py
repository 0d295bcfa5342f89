"""Recordings that are given twice: the second tells nothing, and as evidence it doubles what is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from slam.core.flight import Flight

TELLING = ("imu", "attitude", "velocity", "sonar", "gps")
"""Instruments whose noise is never the same twice. Commands of one script are, and so may be a battery's, a
barometer's or a motor's few steps."""
FEWEST = 10
"""Readings that are alike to the last digit by no chance."""


def without_duplicates(flights: Sequence[Flight]) -> tuple[list[Flight], list[str]]:
    """The flights without those that repeat an earlier one's readings, and a line for each that does."""
    kept: list[Flight] = []
    told = []
    for flight in flights:
        first = next((other for other in kept if same_recording(other, flight)), None)
        if first is None:
            kept.append(flight)
        else:
            told.append(f"{flight.name}: the same recording as {first.name}; it was left out")
    return kept, told


def same_recording(a: Flight, b: Flight) -> bool:
    """Whether an instrument of both has the same readings to the last digit."""
    return any(_alike(getattr(a, name), getattr(b, name)) for name in TELLING)


def _alike(a: Any, b: Any) -> bool:
    if a is None or b is None or not np.array_equal(a.stamps_s, b.stamps_s) or len(a.stamps_s) < FEWEST:
        return False
    count = len(a.stamps_s)
    names = [
        f.name for f in fields(a) if f.name != "stamps_s" and np.shape(getattr(a, f.name))[:1] == (count,)
    ]
    read = [(np.asarray(getattr(a, name)), np.asarray(getattr(b, name))) for name in names]
    return any(np.isfinite(x).any() for x, _ in read) and all(
        np.array_equal(x, y, equal_nan=True) for x, y in read
    )
