"""Timestamp jitter: whether readings were taken at their stamps or at the even clock of their stream.

An instrument samples evenly, but a recorder's stamps may scatter. The offset of each stamp from the even
clock is then known and need not count as noise: the readings fit the motion at one of the two times. Where
they fit the even clock, ``timestamp_jitter`` is reported with its scatter, and flights are judged without it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array
from slam.criticism.cause import SURE, Cause, Interval
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import referred, whole
from slam.criticism.kalman.record import Record, in_order
from slam.criticism.residuals.reading_anomalies import cause_in_readings
from slam.criticism.search.fitting import fit_nuisances
from slam.criticism.search.thresholds import MISFIT
from slam.data_quality.even_clock import LEAST_SCATTER_S, StampOffsets, stamp_offsets

SLOW = 3.0
"""Least period in scatters. Stamps of a faster stream overtake one another, and their offsets in sorted order
are smaller than the jitter."""


def without_jitter(
    records: Sequence[Record], parameters: FilterParameters
) -> tuple[list[Record], list[Cause]]:
    """Return the records at the even times of their streams, and the jitter, if the readings fit these times.

    Otherwise return the records unchanged. A stream without an even clock keeps its stamps.
    """
    streams = [_streams(record) for record in records]
    scattered = [s for flight in streams for s in flight.values() if s.scatter_s > LEAST_SCATTER_S]
    if not scattered:
        return list(records), []
    even = [_evened(record, flight) for record, flight in zip(records, streams, strict=True)]
    nats = _nats(even, parameters) - _nats(records, parameters)
    found = cause_in_readings("timestamp_jitter", {"sigma": _scatter(scattered)}, tuple(nats.tolist()))
    if found.probability < SURE:
        return list(records), []
    return in_threads(lambda record: referred(record, parameters), even), [found]


def _nats(records: Sequence[Record], parameters: FilterParameters) -> Array:
    """Return (flights,) the log likelihoods of the readings of a healthy vehicle."""
    fitted = fit_nuisances(records, parameters)
    return np.array(in_threads(lambda record: whole(record, fitted).log_likelihood, records))


def _streams(record: Record) -> dict[int, StampOffsets]:
    """Return the streams with an even clock, by kind."""
    kinds = np.unique(record.kinds).tolist()
    found = {kind: stamp_offsets(record.times_s[record.kinds == kind]) for kind in kinds}
    return {kind: offsets for kind, offsets in found.items() if offsets is not None}


def _evened(record: Record, streams: dict[int, StampOffsets]) -> Record:
    """Return the record at the even times of its streams."""
    times_s = record.times_s.copy()
    for kind, stamps in streams.items():
        times_s[record.kinds == kind] -= np.nan_to_num(stamps.off_s)
    return in_order(record, times_s, record.kinds, record.values, record.landing)


def _scatter(streams: Sequence[StampOffsets]) -> Interval:
    """Return the jitter's standard deviation from streams with long periods, or from the slowest stream."""
    slow = [s for s in streams if s.period_s > SLOW * s.scatter_s]
    slow = slow or [max(streams, key=lambda s: s.period_s)]
    off_s = np.concatenate([s.off_s[np.isfinite(s.off_s)] for s in slow])
    square = off_s**2
    sigma = float(np.sqrt(square.mean()))
    chance = 1.96 * float(square.std() / np.sqrt(len(square))) / (2.0 * sigma)
    reach = float(np.hypot(chance, MISFIT * sigma))
    return Interval(sigma, "s", max(sigma - reach, 0.0), sigma + reach)
