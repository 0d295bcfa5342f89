"""Anomalies that are corrected before the search: steps in the floor, and scattered stamps.

The height of the vehicle above steps is predicted by a filter without the sonar. An instrument samples
evenly, but a recorder's stamps may scatter. The offset of each stamp from the even clock is then known and
need not count as noise: the readings fit the motion at one of the two times. Where they fit the even clock,
``timestamp_jitter`` is reported with its scatter, and flights are judged without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.criticism.cause import SURE, WIDE, Cause, Interval
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import referred, whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import Record, in_order
from slam.criticism.residuals.reading_anomalies import cause_in_readings, predicted_by_others
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.search.thresholds import MISFIT
from slam.data_quality.boxes import RangeResiduals, find_boxes, nats_by_others, share_over
from slam.data_quality.even_clock import LEAST_SCATTER_S, StampOffsets, jitter_of, stamp_offsets
from slam.simulation.dynamics import PITCH, ROLL, UP, VX, VY, VZ, X, Y, Z

LOWEST_M = 0.3
"""Nearer to the floor the gear and the sonar's own limit cause edges."""


def without_boxes(records: list[Record], parameters: FilterParameters) -> tuple[list[Record], list[Cause]]:
    """Return the records with ranges corrected to a level floor, and the steps if there are any."""
    boxes = find_boxes(in_threads(lambda record: range_residuals(record, parameters), records))
    if not boxes:
        return records, []
    nats = tuple(found.gain_nats for found in boxes)
    by_others = predicted_by_others(boxes, nats_by_others)
    heights = np.concatenate([found.heights_m for found in boxes])
    height, share = float(heights.mean()), share_over(boxes)
    std = math.hypot(float(heights.std()), boxes[0].noise.std_m) / math.sqrt(len(heights))
    spread = math.sqrt(share * (1.0 - share) / len(heights))
    sizes = {
        "height": Interval(height, "m", height - WIDE * std, height + WIDE * std),
        "share": Interval(share, "1", max(share - WIDE * spread, 0.0), min(share + WIDE * spread, 1.0)),
    }
    levelled = []
    for record, found in zip(records, boxes, strict=True):
        values = record.values.copy()
        values[found.seen.rows, 0] += found.sign * found.over_m / found.seen.upright
        levelled.append(replace(record, values=values))
    return levelled, [cause_in_readings("floor_steps", sizes, nats, by_others)]


def range_residuals(record: Record, parameters: FilterParameters) -> RangeResiduals:
    """Return the residuals of the flight's sonar against a filter without sonar readings."""
    sonar = record.kinds == SONAR
    rows = np.flatnonzero(sonar & np.isfinite(record.values[:, 0]) & (record.values[:, 0] > LOWEST_M))
    blind = record.values.copy()
    blind[sonar] = np.nan
    states = whole(replace(record, values=blind), parameters).states[rows]
    times_s = record.times_s[rows]
    upright = np.cos(states[:, ROLL]) * np.cos(states[:, PITCH])
    elapsed = times_s / record.duration_s
    motion = np.column_stack(
        [
            states[:, [Z, VZ, ROLL, PITCH, X, Y]], record.stick.at(times_s)[:, UP], elapsed, elapsed**2,
            states[:, ROLL] ** 2 + states[:, PITCH] ** 2, np.hypot(states[:, VX], states[:, VY]),
        ]
    )  # fmt: skip
    off_m = record.values[rows, 0] * upright - states[:, Z]
    return RangeResiduals(rows, times_s, off_m, motion, upright)


def without_jitter(records: list[Record], parameters: FilterParameters) -> tuple[list[Record], list[Cause]]:
    """Return the records at the even times of their streams, and the jitter, if the readings fit these times.

    Otherwise return the records unchanged. A stream without an even clock keeps its stamps.
    """
    streams = [_streams(record) for record in records]
    scattered = [s for flight in streams for s in flight.values() if s.scatter_s > LEAST_SCATTER_S]
    if not scattered:
        return records, []
    even = []
    for record, flight in zip(records, streams, strict=True):
        times_s = record.times_s.copy()
        for kind, stamps in flight.items():
            times_s[record.kinds == kind] -= np.nan_to_num(stamps.off_s)
        even.append(in_order(record, times_s, record.kinds, record.values, record.landing))
    nats = _nats(even, parameters) - _nats(records, parameters)
    sigma, std = jitter_of(scattered)
    reach = math.hypot(WIDE * std, MISFIT * sigma)
    size = Interval(sigma, "s", max(sigma - reach, 0.0), sigma + reach)
    found = cause_in_readings("timestamp_jitter", {"sigma": size}, tuple(nats.tolist()))
    if found.probability < SURE:
        return records, []
    return in_threads(lambda record: referred(record, parameters), even), [found]


def _nats(records: Sequence[Record], parameters: FilterParameters) -> Array:
    """Return (flights,) the log likelihoods of the readings of a healthy vehicle."""
    fitted = fit_nuisances(records, parameters)
    return np.array(in_threads(lambda record: whole(record, fitted).log_likelihood, records))


def _streams(record: Record) -> dict[int, StampOffsets]:
    """Return the streams with an even clock, by kind."""
    found = {k: stamp_offsets(record.times_s[record.kinds == k]) for k in np.unique(record.kinds).tolist()}
    return {kind: offsets for kind, offsets in found.items() if offsets is not None}
