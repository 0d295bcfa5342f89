"""Whitened innovations of one flight under given parameters, their variances and their sensitivities.

Landing times and the usual variances of innovations are those of one reference run for all parameter sets,
which differ in the vehicle's path and in its delay. If each of them chose which readings a landing spoils,
and an ignored reading counted as nothing, a model would gain by leaving readings out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from slam.core.arrays import Array, Ints
from slam.criticism.kalman.filter import GATE, IGNORED, USED, Z_STD, run
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.kernel_inputs import Perturbation, Signal, filter_run
from slam.criticism.kalman.readings import CHANNEL_AT, CHANNELS, IMU, NO_CHANNEL, by_channel, place_of
from slam.criticism.kalman.record import Record
from slam.simulation.dynamics import GEAR, UP, Z

CONTACT_S = 0.3
"""Time after floor contact in which readings are not used, since landing gears differ."""
REACH_M = 0.08
"""Margin of the contact height: the sonar's zero may be wrong by so much."""


@dataclass(frozen=True)
class Innovations:
    """Innovations of a segment of a flight: one row for each used scalar reading, in order of time."""

    events: Ints
    """(rows,) index into the record's events."""
    channels: Ints
    """(rows,) index into ``readings.CHANNELS``."""
    white: Array
    """(rows,) innovation over its standard deviation: independent and standard normal under the model."""
    sensitivity: Array
    """(rows, perturbations) derivative of the prediction, over the standard deviation."""
    change_of_mean: Array
    """(rows, changes of the noise) change of the prediction, over the standard deviation, ..."""
    change_of_log_variance: Array
    """(rows, changes of the noise) ... and that of the logarithm of the innovation's variance."""


@dataclass(frozen=True)
class FilterPass:
    """Results of the filter over a whole flight, without perturbations, for each reading of the record."""

    record: Record
    white: Array
    """(events, 6) innovation over its standard deviation, outliers included; NaN for ignored readings."""
    log_variance: Array
    """(events, 6) logarithm of the innovation's variance, minus the usual value of its channel."""
    status: Ints
    """(events, 6) ``filter.USED``, ``filter.OUTLIER`` or ``filter.IGNORED``."""
    states: Array
    """(events, 11) moving state predicted before each event, and the standard deviation of z."""

    @property
    def nats(self) -> Array:
        """(events, 6) log likelihood of each reading, minus the mean value of a healthy vehicle.

        An ignored reading has 0 and counts neither for the model nor against it. An outlier counts as much as
        an innovation at the gate.
        """
        square = np.where(self.status == USED, self.white**2, GATE**2)
        return np.where(self.status == IGNORED, 0.0, -0.5 * (square - 1.0 + self.log_variance))

    def of_channel(self, channel: int) -> tuple[Ints, Array, Ints]:
        """Return the events (m,) of a channel, their innovations (m,) and their status (m,)."""
        kind, column = place_of(channel)
        rows = np.flatnonzero(self.record.kinds == kind)
        return rows, self.white[rows, column], self.status[rows, column]

    @property
    def log_likelihood(self) -> float:
        """Sum over all readings."""
        return float(self.nats.sum())


def used_innovations(passes: Sequence[FilterPass], channel: int) -> Array:
    """Return the innovations of a channel of all flights, but for outliers and ignored readings."""
    each = [run.of_channel(channel) for run in passes]
    return np.concatenate([white[status == USED] for _, white, status in each])


def whole(record: Record, parameters: FilterParameters) -> FilterPass:
    """Filter the whole flight in one piece, without perturbations."""
    run = Run(record, parameters)
    for _ in run.segments(np.inf):
        pass
    return run.passed()


def segment_bounds(events: int, segments: int) -> Ints:
    """Return (segments + 1,) the event at which each segment begins, and the end of the last one."""
    return np.linspace(0, events, segments + 1).astype(np.int64)


class Run:
    """A filter run through a flight, segment by segment."""

    def __init__(
        self,
        record: Record,
        parameters: FilterParameters,
        perturbations: Sequence[Perturbation] = (),
        signals: dict[str, Signal] | None = None,
        changed: Sequence[FilterParameters] = (),
        keeps_history: bool = False,
    ) -> None:
        """``changed`` are parameters with slightly different noise; see ``noise``."""
        self._record = record
        noises = [parameters, *changed]
        self._filtered = filter_run(record, noises, perturbations, signals or {}, keeps_history)
        self.history = self._filtered.history
        """Estimates around each event, if the run keeps them."""

    def passed(self) -> FilterPass:
        """Return the results of the events that were filtered."""
        written = self._filtered.written
        log_variance = written.log_variance - self._record.usual_log_variance[CHANNEL_AT[self._record.kinds]]
        return FilterPass(self._record, written.innovation, log_variance, written.status, written.states)

    def segments(self, longest_s: float) -> Iterator[Innovations]:
        """Yield the innovations of one segment after the other. Call it once for each run."""
        events, changes = self._filtered.events, len(self._filtered.noise.hold) - 1
        pieces = max(int(np.ceil((events.times_s[-1] - events.times_s[0]) / longest_s)), 1)
        for begin, end in pairwise(segment_bounds(len(events.times_s), pieces).tolist()):
            readings = int(np.isfinite(events.values[begin:end]).sum())
            written = self._filtered.written._replace(
                sensitivity=np.empty((readings, self._filtered.estimate.sensitivity.shape[1])),
                change_of_mean=np.empty((readings, changes)),
                variance_ratio=np.empty((readings, changes)),
            )
            run(begin, end, self._filtered._replace(written=written))
            event, column = np.nonzero(written.status[begin:end] == USED)
            event += begin
            channels, rows = CHANNEL_AT[events.kinds[event], column], slice(written.rows[0])
            yield Innovations(
                event, channels, written.innovation[event, column], written.sensitivity[rows],
                written.change_of_mean[rows], np.log(written.variance_ratio[rows]),
            )  # fmt: skip


def referred(record: Record, parameters: FilterParameters) -> Record:
    """Return the record with its landing times and usual innovation variances under ``parameters``."""
    # Landing is seen without accelerometer, as the contact shock must not move the height.
    values = record.values.copy()
    values[record.kinds == IMU, 3:6] = np.nan
    states = whole(replace(record, values=values), parameters).states
    low = states[:, Z] - parameters.dynamics[GEAR] < REACH_M + 3.0 * states[:, Z_STD]
    sinks = record.stick.at(record.times_s, parameters.latency_s)[:, UP] <= 0.0
    # Standing counts as well: the gear is so stiff that a tiny height error shows in the accelerometer.
    last = np.maximum.accumulate(np.where(low & sinks, record.times_s, -np.inf))
    usual = np.zeros(len(CHANNELS))
    landed = replace(record, landing=record.times_s - last < CONTACT_S, usual_log_variance=usual)
    run = whole(landed, parameters)
    channels = np.where(run.status == USED, CHANNEL_AT[record.kinds], NO_CHANNEL)
    for channel in np.unique(channels[channels != NO_CHANNEL]):
        usual[channel] = np.median(run.log_variance[channels == channel])
    return replace(landed, usual_log_variance=usual)


def recoloured(record: Record, before: FilterParameters, after: FilterParameters) -> Record:
    """Return the record as ``referred`` would for other AR(1) coefficients of the noise."""
    share = np.log1p(-(after.noise_correlation**2)) - np.log1p(-(before.noise_correlation**2))
    return replace(record, usual_log_variance=record.usual_log_variance + by_channel(*share))
