"""A flight as the filter takes it: readings of all instruments in order of time, and the steps between them.

Readings are in body axes. A missing stream has no events, and a missing value is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from slam.core.arrays import Array, Ints, Mask
from slam.core.flight import Flight
from slam.criticism.kalman.readings import (
    ATTITUDE,
    CHANNELS,
    IMU,
    INSTRUMENTS,
    SONAR,
    VELOCITY,
    by_channel,
    place_of,
)
from slam.data_quality.channels import streams_of
from slam.data_quality.commands import has_commands
from slam.simulation.dynamics import PITCH, ROLL, VX, VY, VZ, YAW, YAW_RATE, Z
from slam.simulation.stick import Stick, stick_of

if TYPE_CHECKING:
    from slam.data_quality.pictures.feature_matches import FeatureMatches

LONGEST_STEP_S = 0.005
"""Longest step of the filter between two events: a tenth of the vehicle's fastest lag."""
HIGH_UP_M = 20.0
FIRST_RANGES, HEIGHT_STD_M = 5, 0.05
MOVING_TILT_RAD, MOVING_TURN_RAD_S, MOVING_M_S = 0.5, 1.5, 2.0
"""Initial standard deviations of tilt, turn rate and velocity of a vehicle in motion."""
LONGEST_GAP_S = 5.0
"""A flight is used only up to the first longer gap between readings."""


@dataclass(frozen=True)
class Record:
    """One flight's readings and command in order of time."""

    name: str
    times_s: Array
    """(events,)."""
    kinds: Ints
    """(events,) ``readings.IMU`` and so on."""
    values: Array
    """(events, 6), NaN for what is missing."""
    elapsed: Array
    """(events,) share of the flight's duration that is over."""
    stick: Stick
    noise_std: Array
    """(channels,) standard deviation of one reading, by the flight's own figures."""
    range_limits: Array
    """(2,) least and greatest range that the sonar reports."""
    start: Array
    """(10,) initial guess of the moving state, and ``start_std`` (10,) its standard deviation."""
    start_std: Array
    landing: Mask
    """(events,) true on the floor and shortly after, where the landing gear spoils readings."""
    usual_log_variance: Array
    """(channels,) log variance of healthy innovations. Both are 0 until ``innovations.referred``."""
    matches: FeatureMatches | None = None
    """Feature matches between its pictures."""

    @cached_property
    def steps(self) -> tuple[Ints, Array, Array]:
        """The filter's steps: (events + 1,) first of each event, (steps,) begins and lengths in seconds."""
        gaps = np.diff(self.times_s, prepend=self.times_s[0])
        counts = np.ceil(gaps / LONGEST_STEP_S - 1e-9).astype(np.int64)
        first = np.concatenate([[0], np.cumsum(counts)])
        length_s = np.repeat(gaps / np.maximum(counts, 1), counts)
        within = np.arange(len(length_s)) - np.repeat(first[:-1], counts)
        return first, np.repeat(self.times_s - gaps, counts) + within * length_s, length_s

    @property
    def shows_heading(self) -> bool:
        """Whether an instrument shows the heading: a gyro, an attitude or pictures.

        Speeds of the body do not depend on it. A heading that they alone would correct breaks the symmetry of
        left and right by rounding errors.
        """
        return self.matches is not None or any(self.has(CHANNELS.index(c)) for c in ("gyro_z", "yaw"))

    @property
    def duration_s(self) -> float:
        """Time from second 0 to the last event, in seconds."""
        return float(self.times_s[-1])

    def has(self, channel: int) -> bool:
        """Return whether the flight has readings of a channel."""
        kind, column = place_of(channel)
        return bool(np.isfinite(self.values[self.kinds == kind, column]).any())


def record_of(flight: Flight) -> Record:
    """Return the flight's readings for the filter.

    Raises ``ValueError`` with the reason if the flight has no readings, or none after the first moment.
    """
    streams = _streams(flight)
    if not streams:
        raise ValueError("no imu, attitude, velocity or sonar readings")
    times = np.concatenate([t for _, t, _ in streams])
    kinds = np.concatenate([np.full(len(t), kind, dtype=np.int64) for kind, t, _ in streams])
    values = np.full((len(times), 6), np.nan)
    for kind, _, of_stream in streams:
        values[kinds == kind, : of_stream.shape[1]] = of_stream
    order = np.argsort(times, kind="stable")
    gaps = np.flatnonzero(np.diff(times[order]) > LONGEST_GAP_S)
    order = order[: gaps[0] + 1] if len(gaps) else order
    times, kinds, values = times[order], kinds[order], values[order]
    if times[-1] <= 0.0:
        raise ValueError(f"a reading, and then none for more than {LONGEST_GAP_S:g} s")
    if flight.command is None or not has_commands(flight):
        stick = Stick(np.zeros(1), np.zeros((1, 4)), float(times[-1]))
    else:
        stick = stick_of(flight.command, float(times[-1]))
    start, start_std = _start(kinds, values)
    # By the flight's own figures; 1 without the instrument.
    std = {s.name: s.noise_std for s in streams_of(flight)}
    noise_std = np.maximum(by_channel(*(std.get(name, 1.0) for name in INSTRUMENTS)), 1e-6)
    limits = (flight.sonar.min_range_m, flight.sonar.max_range_m) if flight.sonar else (0.0, np.inf)
    return Record(
        name=flight.name, times_s=times, kinds=kinds, values=values, stick=stick, start=start,
        start_std=start_std, elapsed=np.clip(times / times[-1], 0.0, 1.0),
        noise_std=noise_std, range_limits=np.array(limits, dtype=float),
        landing=np.zeros(len(times), dtype=bool), usual_log_variance=np.zeros_like(noise_std),
    )  # fmt: skip


def _streams(flight: Flight) -> list[tuple[int, Array, Array]]:
    streams: list[tuple[int, Array, Array]] = []
    if flight.imu is not None:
        turn = flight.imu.b_T_s[:3, :3].T
        both = np.column_stack([_finite(flight.imu.gyro_rad_s) @ turn, _finite(flight.imu.accel_m_s2) @ turn])
        streams.append((IMU, flight.imu.stamps_s, both))
    if flight.attitude is not None:
        streams.append((ATTITUDE, flight.attitude.stamps_s, flight.attitude.roll_pitch_yaw_rad))
    if flight.velocity is not None:
        streams.append((VELOCITY, flight.velocity.stamps_s, flight.velocity.v_m_s))
    if flight.sonar is not None:
        streams.append((SONAR, flight.sonar.stamps_s, flight.sonar.range_m[:, None]))
    kept = []
    for kind, stamps, values in streams:
        finite = _finite(values)
        some = np.isfinite(finite).any(axis=1) & np.isfinite(stamps)
        if some.any():
            kept.append((kind, stamps[some], finite[some]))
    return kept


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def in_order(record: Record, times_s: Array, kinds: Ints, values: Array, landing: Mask) -> Record:
    """Return the record with other events (events,), given in any order; none is before second 0."""
    order = np.argsort(times_s, kind="stable")
    times_s = np.maximum(times_s[order], 0.0)
    return replace(
        record, times_s=times_s, kinds=kinds[order], values=values[order], landing=landing[order],
        elapsed=np.clip(times_s / times_s[-1], 0.0, 1.0),
    )  # fmt: skip


def with_events(record: Record, own: Mask) -> Record:
    """Return the record with some successive events; the mask ``own`` is (events,)."""
    return replace(
        record, times_s=record.times_s[own], kinds=record.kinds[own], values=record.values[own],
        elapsed=record.elapsed[own], landing=record.landing[own],
    )  # fmt: skip


def moving_from(record: Record, begin_s: float, end_s: float) -> Record:
    """Return the record's events of an interval at whose beginning the vehicle moves in an unknown way."""
    flown = with_events(record, (record.times_s >= begin_s) & (record.times_s <= end_s))
    start, start_std = _start(flown.kinds, flown.values)
    start_std[[ROLL, PITCH]], start_std[YAW_RATE] = MOVING_TILT_RAD, MOVING_TURN_RAD_S
    start_std[[VX, VY, VZ]] = MOVING_M_S
    return replace(flown, start=start, start_std=start_std)


def _start(kinds: Ints, values: Array) -> tuple[Array, Array]:
    """Return the initial guess and its deviation from the first readings, as linearisation point."""
    start, std = np.zeros(10), np.zeros(10)
    std[[VX, VY, VZ]], std[[ROLL, PITCH]], std[YAW_RATE] = (0.3, 0.3, 0.1), 0.05, 0.1
    if (k := np.flatnonzero((kinds == ATTITUDE) & np.isfinite(values[:, 2]))).size:
        # Only the heading: the vehicle is known to be level and at rest.
        start[YAW], std[YAW] = values[k[0], 2], 0.05
    # Without a sonar the height is unknown: assume one far from the floor, where it has no effect.
    start[Z], std[Z] = HIGH_UP_M, 0.5
    if (k := np.flatnonzero(kinds == SONAR)).size:
        # The median of some: a single one may be a second echo and must not pass for the height.
        some = values[k[:FIRST_RANGES], 0]
        start[Z] = np.median(some)
        std[Z] = HEIGHT_STD_M + 1.5 * np.median(np.abs(some - start[Z]))
    if (k := np.flatnonzero(kinds == VELOCITY)).size:
        u, w = np.nan_to_num(values[k[0], :2])
        c, s = np.cos(start[YAW]), np.sin(start[YAW])
        start[VX], start[VY] = c * u - s * w, s * u + c * w
    return start, std
