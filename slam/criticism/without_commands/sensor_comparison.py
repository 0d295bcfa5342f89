"""Comparison of the instruments of flights: inertial consistency, pictures, and single readings.

Pictures and single readings are compared with a filter for unknown inputs: the filter's equations with
inflated process noise, which constrain nothing. It gives the motion that all instruments agree on.

Errors ahead correspond to those of roll-outs with commands: from a moment at which an instrument is trusted,
the gyro or the accelerometer alone predicts its reading. A height is predicted from two moments, the begin
and the middle: no instrument measures its initial rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frontend.cores import in_threads
from slam.core.arrays import Array, Ints
from slam.core.flight import Flight
from slam.core.progress import Progress, Tally, silent
from slam.criticism.camera.reprojection import without_mismatched_pairs
from slam.criticism.cause import Cause, ChannelError
from slam.criticism.kalman.filter_parameters import FilterParameters, filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import Record, moving_from, record_of
from slam.criticism.kalman.transition import HOLD
from slam.criticism.residuals.reading_anomalies import reading_anomalies, without_dead_zone
from slam.criticism.search.information import SEGMENT_S
from slam.criticism.search.search import SearchResult
from slam.criticism.verdict.held_out import parts_of
from slam.criticism.without_commands.likelihood import Sizes, picture_rows
from slam.data_quality.inertial_comparison import Averages, near_floor, segment_numbers
from slam.data_quality.lag import Lag
from slam.data_quality.pictures.feature_matches import FeatureMatches, match_all_pictures
from slam.data_quality.whitened_rows import (
    FlightRows,
    WhitenedRows,
    begin_of,
    inertial_residuals,
    lags_of,
    segments_of,
)
from slam.simulation.model import Model
from slam.simulation.replay.compare import HORIZONS_S

PROCESS_NOISE = {
    "tilt_std_rad": 0.3, "tilt_time_s": 0.2, "yaw_rate_std_rad_s": 1.5, "yaw_rate_time_s": 0.2,
    "velocity_std_m_s": 1.0, "velocity_time_s": 0.2, "velocity_up_std_m_s": 1.0,
}  # fmt: skip
"""Entries of ``HOLD``: the motion of a hand."""
CLEAR_S = 0.3
"""Least time from a reading near the floor."""
SHORTEST_S = 5.0


@dataclass(frozen=True)
class SensorComparison:
    """Flights with the comparisons of their instruments."""

    comparisons: tuple[list[WhitenedRows], ...]
    lags: dict[str, Lag]
    """Lags of streams about which the comparisons are linear."""
    records: Sequence[Record | None]
    """Readings of each flight in the air, with its pictures; None where it is not known to fly."""
    parameters: FilterParameters
    """Filter parameters with inflated process noise."""
    anomalies: Sequence[Cause]
    """Causes that single readings show."""
    dropped: Sequence[str]
    """Descriptions of what was left out."""

    @staticmethod
    def of(flights: Sequence[Flight], model: Model, progress: Progress = silent) -> SensorComparison:
        """Compare each instrument of the flights with the others."""
        tally = Tally(progress, "instruments", len(flights))
        lags = lags_of(flights)
        comparisons = tuple(inertial_residuals(flight, lags) for flight in tally.each(flights))
        parameters = with_free_motion(filter_parameters_of(model))
        records, dropped = [], []
        every = zip(map(airborne_record, flights), match_all_pictures(flights, progress), strict=True)
        for record, matches in every:
            if record is not None and matches is not None:
                record, description = without_mismatched_pairs(replace(record, matches=matches), parameters)
                dropped += [description] if description else []
            records.append(record)
        anomalies: list[Cause] = []
        if known := [record for record in records if record is not None]:
            clean, anomalies = without_dead_zone(known)
            anomalies += reading_anomalies(in_threads(lambda record: whole(record, parameters), clean))
        return SensorComparison(comparisons, lags, records, parameters, anomalies, dropped)

    @property
    def matches(self) -> FeatureMatches | None:
        """Feature matches of the first flight that has any."""
        every = (record.matches for record in self.records if record is not None)
        return next((matches for matches in every if matches is not None), None)

    def rows(self, sizes: Sizes) -> list[list[WhitenedRows]]:
        """Return the rows of each flight; those of pictures are linear about ``sizes`` of parameters."""

        def with_pictures(k: int) -> list[WhitenedRows]:
            known, record = self.comparisons[k], self.records[k]
            if record is None or record.matches is None:
                return known
            begin_s = begin_of(known, float(record.times_s[0]))
            return [*known, *picture_rows(record, self.parameters, sizes, begin_s)]

        return in_threads(with_pictures, range(len(self.records)))


def with_free_motion(parameters: FilterParameters) -> FilterParameters:
    """Return the parameters with inflated process noise, which describe the instruments alone."""
    hold = parameters.hold.copy()
    hold[[HOLD.index(name) for name in PROCESS_NOISE]] = list(PROCESS_NOISE.values())
    return replace(parameters, hold=hold)


def airborne_record(flight: Flight) -> Record | None:
    """Return the longest segment between readings near the floor; None where there is no sonar, where it is
    short, or where fewer than two of imu, attitude and velocity measure the motion."""
    if flight.sonar is None or [flight.imu, flight.attitude, flight.velocity].count(None) > 1:
        return None
    try:
        record = record_of(flight)
    except ValueError:
        return None
    ends_s = record.times_s[[0, -1]] + CLEAR_S * np.array([-1.0, 1.0])
    low_s = np.concatenate([ends_s[:1], near_floor(flight), ends_s[1:]])
    longest = int(np.argmax(np.diff(low_s)))
    begin_s, end_s = low_s[longest] + CLEAR_S, low_s[longest + 1] - CLEAR_S
    if end_s - begin_s < SHORTEST_S:
        return None
    return moving_from(record, begin_s, end_s)


def channel_errors(found: SearchResult, rows: FlightRows, by: str) -> tuple[ChannelError, ...]:
    """Return root mean square errors over each horizon, before and after the sizes of the chosen terms are
    removed from each part, as all others give them; parts are ``by`` flight or segment."""
    part, _ = parts_of(found.last.fisher.flight)
    terms = [e.name for e in found.chosen if e.is_term]
    of_part = {k: found.last.over(part != k).sizes(found.chosen) for k in np.unique(part).tolist()}
    sizes: list[dict[int, Sizes]] = [{} for _ in rows]
    for (flight, number), k in zip(segments_of(rows, SEGMENT_S)[0].tolist(), part.tolist(), strict=True):
        sizes[flight][number] = {c: x for c, x in of_part[k].items() if c.rpartition(".")[0] in terms}
    squares: dict[tuple[str, str, float], list[Array]] = {}
    for of_flight, of_segment in zip(rows, sizes, strict=True):
        for averages in (r.averages for r in of_flight if r.averages is not None):
            segment = segment_numbers(averages.times_s, begin_of(of_flight), SEGMENT_S)
            for horizon in HORIZONS_S:
                apart = _errors_of(averages, horizon, segment, of_segment, by == "flight")
                squares.setdefault((averages.channel, averages.unit, horizon), []).append(apart**2)
    errors = []
    for (channel, unit, horizon), of in squares.items():
        pooled = np.concatenate(of)
        if len(pooled):
            before, after = np.sqrt(pooled.mean(axis=0))
            errors.append(ChannelError(channel, unit, horizon, float(before), float(after)))
    return tuple(sorted(errors, key=lambda e: e.horizon_s))


def _errors_of(
    averages: Averages, horizon_s: float, segment: Ints, sizes: Mapping[int, Sizes], whole_flight: bool
) -> Array:
    """Return errors (n, 2) before and after, from every moment whose horizon lies within one part. ``sizes``
    are those of each ``segment`` (moments,)."""
    apart, kept = averages.ahead(horizon_s)
    begin, end = segment[: len(kept)], segment[len(segment) - len(kept) :]
    kept = kept & (whole_flight | (begin == end)) & np.isin(begin, list(sizes))
    explained = np.zeros(len(kept))
    for number, of in sizes.items():
        for name, size in of.items():
            if name in averages.names:
                explained[begin == number] += size * apart[begin == number, averages.column(name)]
    return np.asarray(np.column_stack([apart[:, 0], apart[:, 0] - explained])[kept])
