"""Frozen readings: a stream that repeats its last reading for a while, and then goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.significance import RARE_LOG_CHANCE
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.finding import Finding

Array = NDArray[np.float64]

SHORTER = 2.0 / 3.0
FEWEST_RUNS = 3
"""Least number of frozen runs that may be at any value and at any time. Of fewer, those count that lie within
the range of the others, and that are no rest of the vehicle: it may stand on the floor before and after."""
SINGLE_S = 1.0
"""Least duration of a single frozen run, in seconds."""
NO_REST_S = 5.0
"""The same of one that may be a rest: a vehicle hovers for less without any motion that is rounded away."""
RUN = 8
"""Number of equal successive readings, to the last digit, that noise does not make."""


@dataclass(frozen=True)
class Frozen(Finding):
    """The frozen runs of a stream (``channel``)."""

    begin_s: Array
    """(runs,)."""
    lasts_s: Array
    """(runs,)."""
    share: float
    """Share of the stream's readings."""
    repeated: NDArray[np.bool_]
    """(n,) readings that repeat the one before within a frozen run."""

    def _text(self) -> str:
        often = f"{len(self.begin_s)} times for about " if len(self.begin_s) > 1 else "for "
        since = f"{'first ' if len(self.begin_s) > 1 else ''}at {self.begin_s[0]:.0f} s"
        return (
            f"the {self.channel} repeats its reading {often}{np.median(self.lasts_s):.2g} s, {since} "
            f"({100 * self.share:.0f} % of its readings)"
        )


def never(begin_s: float, end_s: float) -> bool:
    """Return False: no other instrument shows a motion between two times."""
    return False


def frozen(stream: InstrumentReadings, moves: Callable[[float, float], bool] = never) -> Frozen | None:
    """Return the frozen runs of a stream, or None. ``moves``: whether others show a motion between two times.

    A run is improbable if its length is, given how often successive readings of shorter runs are equal. Runs
    at one value alone are no freeze: an instrument may stop at its limit.
    """
    finite = np.asarray(np.isfinite(stream.values).all(axis=1))
    times_s, values = stream.stamps_s[finite], stream.values[finite]
    if len(values) < 2:
        return None
    equal = np.all(values[1:] == values[:-1], axis=1)
    begin, length = _runs(equal)
    # A slow sensor is logged several times a reading: its readings count, not the log's rows.
    stuck = length >= _shortest_improbable(length / float(np.median(length)), len(values)) * np.median(length)
    stuck_at = {tuple(reading) for reading in values[begin[stuck]].tolist()}
    if int(stuck.sum()) < FEWEST_RUNS or len(stuck_at) < FEWEST_RUNS:
        stuck &= _within_others(times_s, values, begin, length, moves)
    if not stuck.any():
        return None
    repeated = np.zeros(len(finite), dtype=np.bool_)
    of_finite = np.flatnonzero(finite)
    for first, count in zip(begin[stuck], length[stuck], strict=True):
        repeated[of_finite[first + 1 : first + count]] = True
    last = begin[stuck] + length[stuck] - 1
    lasts_s = times_s[last] - times_s[begin[stuck]]
    return Frozen(times_s[begin[stuck]], lasts_s, float(repeated.mean()), repeated, channel=stream.name)


def _within_others(
    times_s: Array, values: Array, begin: NDArray[np.int64], length: NDArray[np.int64],
    moves: Callable[[float, float], bool],
) -> NDArray[np.bool_]:  # fmt: skip
    """Return which runs of equal readings are long, lie within the others in value or at 0, and are no rest:
    at the begin, at the end and at 0 the vehicle must move."""
    ends_s, at = times_s[begin + length - 1], values[begin]
    lasts_s = ends_s - times_s[begin]
    within = ((at > values.min(axis=0)) & (at < values.max(axis=0))).any(axis=1)
    counts = (within | (at == 0.0).all(axis=1)) & (lasts_s >= SINGLE_S)
    may_rest = (at == 0.0).any(axis=1)
    may_rest[[0, -1]] = True
    for k in np.flatnonzero(counts & may_rest).tolist():
        counts[k] = lasts_s[k] >= NO_REST_S and moves(float(times_s[begin[k]]), float(ends_s[k]))
    return np.asarray(counts)


def _shortest_improbable(count: Array, readings: int) -> float:
    """Return the least length from which runs of equal readings, with lengths ``count``, are improbable;
    infinite if none is.

    How often a reading equals the one before shows in runs of less than ``SHORTER`` of a length: frozen runs
    of similar lengths are no evidence that they are usual.
    """
    of_length, inverse = np.unique(count, return_inverse=True)
    runs = np.bincount(inverse)
    equal = np.append(0.0, np.cumsum(runs * np.maximum(of_length - 1.0, 0.0)))
    of_all = np.append(0.0, np.cumsum(runs * of_length))
    shorter = np.searchsorted(of_length, SHORTER * of_length)
    share = (equal[shorter] + 1.0) / (of_all[shorter] + 1.0)
    log_chance = np.log(readings) + (of_length - 1.0) * np.log(np.minimum(share, 0.9))
    improbable = of_length[log_chance < RARE_LOG_CHANCE]
    return float(improbable[0]) if len(improbable) else np.inf


def at_least_value(readings: Array) -> NDArray[np.bool_]:
    """Return which readings (n,) lie within long runs of the least value: an instrument stops at its
    limit."""
    if not np.isfinite(readings).any():
        return np.zeros(len(readings), dtype=np.bool_)
    begin, length = _runs(readings[1:] == readings[:-1])
    long = (length >= RUN) & (readings[begin] == np.nanmin(readings))
    return np.repeat(long, length)


def lowest_run(readings: Array) -> float:
    """Return the least limit below which a long run of readings (n,) lies, so that it would show; infinite
    without one."""
    if len(readings) < RUN:
        return np.inf
    runs = np.lib.stride_tricks.sliding_window_view(readings, RUN).max(axis=1)
    return float(np.min(runs, initial=np.inf, where=np.isfinite(runs)))


def _runs(equal: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the begin and the length of each run of readings (n,); ``equal`` (n - 1,) tells which of them
    equal the one before."""
    edges = np.flatnonzero(np.concatenate([[True], ~equal, [True]]))
    return edges[:-1], np.diff(edges)
