"""One flight under one belief: whitened innovations, their variances, and the traces of directions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from slam.criticism.kalman.coloured import coloured_for
from slam.criticism.kalman.filter import IGNORED, USED, run, start_noise
from slam.criticism.kalman.readings import (
    CHANNEL_AT,
    CHANNELS,
    STATES,
    STATES_WITH_GUSTS,
)
from slam.criticism.kalman.record import Record
from slam.criticism.kalman.setting import Setting
from slam.criticism.kalman.steps import GATE
from slam.criticism.kalman.tangents import Direction, Signal, tangents_for
from slam.criticism.kalman.transition import GUST_STD

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Innovations:
    """A stretch of a flight: one row a scalar reading that was used, in order of time."""

    events: Ints
    """(rows,) index into the record's events."""
    channels: Ints
    """(rows,) index into ``readings.CHANNELS``."""
    white: Array
    """(rows,) innovation over its standard deviation: independent and standard normal under the belief."""
    traces: Array
    """(rows, directions): change of the prediction with the direction, over the standard deviation."""


@dataclass(frozen=True)
class Pass:
    """A whole run of the filter over a flight without directions, on the grid of the record's readings."""

    white: Array
    """(events, 6) innovation over its standard deviation, also of outliers; NaN where nothing was judged."""
    log_variance: Array
    """(events, 6) of the innovation, less the usual one of its channel."""
    status: Ints
    """(events, 6) ``filter.USED``, ``filter.OUTLIER`` or ``filter.IGNORED``."""
    states: Array
    """(events, 11) moving state predicted before each event, and the standard deviation of z."""

    @property
    def nats(self) -> Array:
        """(events, 6) log likelihood of each reading, less what a healthy vehicle's is on average.

        So one that a belief does not judge, by 0, counts neither for that belief nor against it; an outlier
        counts as much as one at the gate.
        """
        square = np.where(self.status == USED, self.white**2, GATE**2)
        return np.where(self.status == IGNORED, 0.0, -0.5 * (square - 1.0 + self.log_variance))

    @property
    def log_likelihood(self) -> float:
        """Of all readings together."""
        return float(self.nats.sum())


def stretches(
    record: Record,
    setting: Setting,
    directions: Sequence[Direction] = (),
    signals: dict[str, Signal] | None = None,
    longest_s: float = 10.0,
) -> Iterator[Innovations]:
    """The rows of one stretch of the flight after the other."""
    yield from _Run(record, setting, directions, signals or {}).stretches(longest_s)


def whole(record: Record, setting: Setting) -> Pass:
    """The flight in one piece, without directions."""
    filtered = _Run(record, setting, (), {})
    for _ in filtered.stretches(np.inf):
        pass
    log_variance = filtered.log_variance - record.usual_log_variance[CHANNEL_AT[record.kinds]]
    return Pass(filtered.white, log_variance, filtered.status, filtered.states)


class _Run:
    """The filter's arrays while it goes through a flight."""

    def __init__(
        self, record: Record, setting: Setting, directions: Sequence[Direction], signals: dict[str, Signal]
    ) -> None:
        self._record, self._setting = record, setting
        self._table = tangents_for(record, setting, directions, signals)
        n = STATES_WITH_GUSTS if setting.hold[GUST_STD] > 0 else STATES
        self._m, events = len(directions), len(record.times_s)
        self._state, self._p, self._tangents = np.zeros(n), np.zeros((n, n)), np.zeros((n, self._m))
        self._state[:10] = record.start
        self._p[np.arange(10), np.arange(10)] = record.start_std**2
        start_noise(setting.hold, self._p)
        self._coloured = coloured_for(record, setting, n, self._m)
        self._memory = np.zeros(len(CHANNELS))
        self.white, self.log_variance = np.full((events, 6), np.nan), np.full((events, 6), np.nan)
        self.status, self.states = np.zeros((events, 6), dtype=np.int64), np.zeros((events, 11))

    def stretches(self, longest_s: float) -> Iterator[Innovations]:
        record, setting, table = self._record, self._setting, self._table
        noise_var = (record.noise_std * setting.noise_factor) ** 2
        pieces = max(int(np.ceil((record.times_s[-1] - record.times_s[0]) / longest_s)), 1)
        bounds = np.linspace(0, len(record.times_s), pieces + 1).astype(np.int64)
        keep = np.zeros(1, dtype=np.int64)
        for begin, end in pairwise(bounds.tolist()):
            readings = int(np.isfinite(record.values[begin:end]).sum())
            traces = np.empty((readings, self._m))
            run(
                begin, end, record.times_s, record.kinds, record.values, record.elapsed, record.landing,
                table.jumps, record.first_step, record.step_s, table.sticks, table.jolts,
                setting.late_std_s**2,
                table.commands, setting.parameters, setting.sensor, setting.hold,
                noise_var, setting.jitter_s, record.range_limits, self._state, self._p, self._memory,
                table.acts, table.reads, table.stick_of, table.parameters_of, table.sensor_of,
                table.inject_at, table.signal_of, table.step_signals, table.event_signals, table.scale,
                self._tangents, self.white, self.log_variance, self.status, traces, self.states, keep,
                self._coloured,
            )  # fmt: skip
            used = self.status[begin:end] == USED
            events, column = np.nonzero(used)
            events += begin
            yield Innovations(
                events,
                CHANNEL_AT[record.kinds[events], column],
                self.white[events, column],
                traces[: keep[0]],
            )
