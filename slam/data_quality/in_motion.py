"""Motion by the other instruments: whether a vehicle flies while one of its instruments shows nothing.

On the floor many instruments rest, or are switched off. An instrument fails only where others show a flight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.core.arrays import Array
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.inertial_comparison import LOWEST_M

FEWEST = 20
"""Least number of readings that show motion, and of those that they are compared with."""
MOVING = 0.2
"""Least scatter within a second, as a share of what is usual in the flight. A rotor at rest leaves the gyros
of the measured vehicles a twentieth of it, and a hover between brisk manoeuvres a third."""
BRISK = 0.95
"""Quantile of the seconds that stands for the briskest motion, a blow at landing left out."""


def others_move(streams: Sequence[InstrumentReadings], name: str, begin_s: float, end_s: float) -> bool:
    """Whether any instrument but that of a name shows a flight between two times."""
    return any(_moves(other, begin_s, end_s) for other in streams if other.name != name)


def _moves(stream: InstrumentReadings, begin_s: float, end_s: float) -> bool:
    finite = np.isfinite(stream.values).all(axis=1)
    times_s, values = stream.stamps_s[finite], stream.values[finite]
    inside = (times_s >= begin_s) & (times_s <= end_s)
    if min(inside.sum(), (~inside).sum()) < FEWEST:
        return False
    if stream.name == "sonar":
        return bool(np.median(values[inside]) > LOWEST_M)
    within, outside = (_scatters(times_s[part], values[part]) for part in (inside, ~inside))
    if not len(within) or not len(outside):
        return False
    # A record may be at rest for most of its time: what is usual is that of the seconds in motion.
    usual = outside[outside >= MOVING * np.quantile(outside, BRISK)]
    return bool(np.median(within) > MOVING * np.median(usual))


def _scatters(times_s: Array, values: Array) -> Array:
    """Return the standard deviations (seconds,) of some readings (n, channels) within each second."""
    edges = np.flatnonzero(np.diff(np.floor(times_s))) + 1
    stds = [part.std(axis=0) for part in np.split(values, edges) if len(part) > 1]
    return np.asarray(np.linalg.norm(np.reshape(stds, (len(stds), values.shape[1])), axis=1))
