"""Smallest detectable size of the effects on single readings, for a power of nine in ten."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import gamma

from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.reading_anomalies import FEWEST_SPIKES, ranges_of
from slam.data_quality.frozen import RUN
from slam.data_quality.lost_pictures import LOST_NATS, LostPictures
from slam.simulation.terms import CATALOGUE

CERTAIN = 0.9
MOST_LOST = 50
"""Greatest number of lost pictures that is tried."""


def smallest_in_readings(records: Sequence[Record]) -> dict[str, tuple[float, str]]:
    """Return name -> size and unit of a sonar's second echoes and dead zone, and of lost pictures.

    A dead zone shows where readings lie below it for long enough; echoes and losses are Poisson counts.
    """
    found = {
        "sonar_spikes": _share(FEWEST_SPIKES, len(ranges_of(records))),
        "sonar_dead_zone": _lowest_run(records),
        "dropped_frames": _lost(sum(r.matches.taken for r in records if r.matches is not None)),
    }
    return {n: (size, CATALOGUE[n].parameters[0].unit) for n, size in found.items() if np.isfinite(size)}


def _share(count: int, among: int) -> float:
    """Return the share that gives at least ``count`` of ``among`` in nine of ten cases."""
    return float(gamma.ppf(CERTAIN, count)) / among if among else np.inf


def _lowest_run(records: Sequence[Record]) -> float:
    """Return the least maximum of ``RUN`` successive readings."""
    lowest = np.inf
    for record in records:
        ranges = record.values[record.kinds == SONAR, 0]
        if len(ranges) >= RUN:
            runs = np.lib.stride_tricks.sliding_window_view(ranges, RUN).max(axis=1)
            lowest = min(lowest, float(np.min(runs, initial=np.inf, where=np.isfinite(runs))))
    return lowest


def _lost(taken: int) -> float:
    for count in range(1, MOST_LOST):
        if LostPictures(count, taken + count).nats(count / max(taken + count, 1)) >= LOST_NATS:
            return _share(count, taken)
    return np.inf
