"""Steps in the floor as a cause: the height of the vehicle is predicted by a filter without the sonar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from frontend.cores import in_threads
from slam.criticism.cause import Cause, Interval
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import Record
from slam.criticism.residuals.reading_anomalies import cause_in_readings, predicted_by_others
from slam.data_quality.boxes import Boxes, RangeResiduals, find_boxes, nats_by_others, share_over
from slam.simulation.dynamics import PITCH, ROLL, UP, VX, VY, VZ, X, Y, Z

LOWEST_M = 0.3
"""Nearer to the floor the gear and the sonar's own limit cause edges."""


def without_boxes(
    records: Sequence[Record], parameters: FilterParameters
) -> tuple[list[Record], list[Cause]]:
    """Return the records with ranges corrected to a level floor, and the steps if there are any."""
    boxes = find_boxes(in_threads(lambda record: range_residuals(record, parameters), records))
    if not boxes:
        return list(records), []
    nats = tuple(found.gain_nats for found in boxes)
    by_others = predicted_by_others(boxes, nats_by_others)
    levelled = [_levelled(record, found) for record, found in zip(records, boxes, strict=True)]
    return levelled, [cause_in_readings("floor_steps", _sizes(boxes), nats, by_others)]


def _sizes(boxes: Sequence[Boxes]) -> dict[str, Interval]:
    heights = np.concatenate([found.heights_m for found in boxes])
    height, share = float(heights.mean()), share_over(boxes)
    std = math.hypot(float(heights.std()), boxes[0].noise.std_m) / math.sqrt(len(heights))
    spread = math.sqrt(share * (1.0 - share) / len(heights))
    return {
        "height": Interval(height, "m", height - 1.96 * std, height + 1.96 * std),
        "share": Interval(share, "1", max(share - 1.96 * spread, 0.0), min(share + 1.96 * spread, 1.0)),
    }


def _levelled(record: Record, found: Boxes) -> Record:
    values = record.values.copy()
    values[found.seen.rows, 0] += found.sign * found.over_m / found.seen.upright
    return replace(record, values=values)


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
