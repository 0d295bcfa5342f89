"""Readings beside the integrals of the imu: tilt from the gyro, speed and height from the accelerometer.

For any motion, tilt is the integral of the gyro, speed that of the accelerometer, and height the second
integral. No equation of motion of the vehicle is involved, so that pilot and wind do not matter. Readings are
averaged about moments half a second apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from backend.measurements import GRAVITY_M_S2
from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.core.rotations import rotation_of
from slam.data_quality.lag import PROMPT, Lag

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NODE_S, ABOUT_S = 0.5, 0.1
"""Spacing of the moments, and half the time about each over which differences are averaged."""
ROUNDING_S = 1e-6
"""Greatest rounding error of stamps. Readings on the edge of an interval must not depend on it."""
FEWEST = 20
"""Least number of readings, and of moments, of a comparison."""
LONGEST_GAP_S = 0.15
"""Longest time between readings, and between samples of the imu, that a comparison bridges."""
LOWEST_M = 0.35
"""Least height: nearer to the floor the vehicle may touch it, which shakes all instruments."""
JUMP = 6.0
"""Least jump of a rate between samples, beside its neighbours, in standard deviations."""
INTEGRATED = " as integrated"
"""Suffix of the second estimate of the quantity that a scale multiplies."""
CHANNELS = {
    "attitude": [(f"{angle} from the gyro", "rad") for angle in ("roll", "pitch", "yaw")],
    "velocity": [(f"velocity {way} from the accelerometer", "m/s") for way in ("east", "north")],
    "height": [("height from the accelerometer", "m")],
}
"""Name and unit of each component of a comparison."""
BETWEEN_SAMPLES = "gyro between samples"
"""Column of the effect of jumps of the rate between samples. The moment between the samples is unknown. Where
sticks jump at even times it is always the same."""


@dataclass(frozen=True)
class ImuReadings:
    """The imu of a flight, with the attitude at its stamps."""

    stamps_s: Array
    gyro: Array
    accel: Array
    angles: Array
    """(n, 3) roll, pitch, yaw."""
    w_R_b: Array
    """(n, 3, 3) the same as rotations."""
    lags: Mapping[str, Lag] = field(default_factory=dict)
    """Stream -> lag of its readings; none for those that are prompt. The attitude is without its lag."""

    def lagged(self, stream: str, signal: Array) -> Array:
        """Return a signal (n, k) of the motion as a stream reads it."""
        return self.lags.get(stream, PROMPT).of(self.stamps_s, signal)

    @property
    def w_accel(self) -> Array:
        """(n, 3) specific force in the world."""
        return np.asarray(np.einsum("nij,nj->ni", self.w_R_b, self.accel))

    @property
    def turn(self) -> Array:
        """(n, 3) rates of roll, pitch and yaw by the gyro."""
        return np.asarray(np.einsum("nij,nj->ni", _angle_rates(self.angles), self.gyro))

    def integral(self, rate: Array) -> Array:
        """Return the integral (n, k) of a rate (n, k)."""
        step = np.diff(self.stamps_s)[:, None] * 0.5 * (rate[1:] + rate[:-1])
        return np.vstack([np.zeros(rate.shape[1]), np.cumsum(step, axis=0)])

    def at(self, times_s: Array, signal: Array) -> Array:
        """Return a signal (n, k) at other times, (m, k)."""
        return np.column_stack([np.interp(times_s, self.stamps_s, column) for column in signal.T])


@dataclass(frozen=True)
class IntegralComparison:
    """Readings of one kind and the integral of the imu, at the readings' own stamps."""

    stamps_s: Array
    read: Array
    """(n, components)."""
    integral: Array
    """(n, components)."""
    order: int
    """Number of integrations of the imu."""
    yaw: Array
    """(n,)."""
    others: Callable[[], dict[str, Array]] = dict
    """Return further columns (n, components), which belong to no term."""

    @property
    def off(self) -> Array:
        """Differences (n, components)."""
        return self.read - self.integral


def comparisons(
    flight: Flight, lags: Mapping[str, Lag] | None = None
) -> list[tuple[str, IntegralComparison]]:
    """Return every kind of comparison that the flight's streams allow, with the lags of some streams."""
    flight = with_finite_imu(flight)
    imu = imu_of(flight, lags)
    if imu is None:
        return []
    every = ((kind, compare(flight, imu)) for kind, compare in _COMPARISONS.items())
    return [(kind, seen) for kind, seen in every if seen is not None]


def compared(flight: Flight, imu: ImuReadings, kind: str) -> IntegralComparison:
    """Return the comparison of a kind that the flight's streams allow, beside the integrals of an imu."""
    seen = _COMPARISONS[kind](flight, imu)
    assert seen is not None
    return seen


def with_finite_imu(flight: Flight) -> Flight:
    """Return the flight without imu readings that are no numbers."""
    imu = flight.imu
    if imu is None:
        return flight
    kept = np.isfinite(imu.gyro_rad_s).all(axis=1) & np.isfinite(imu.accel_m_s2).all(axis=1)
    finite = replace(
        imu,
        stamps_s=imu.stamps_s[kept],
        gyro_rad_s=imu.gyro_rad_s[kept],
        accel_m_s2=imu.accel_m_s2[kept],
    )
    return replace(flight, imu=finite)


def imu_of(flight: Flight, lags: Mapping[str, Lag] | None = None) -> ImuReadings | None:
    """Return the imu in body axes where imu and attitude are known, else None.

    What the gyro turned within the ``lags`` of the attitude is added to that.
    """
    if flight.imu is None or flight.attitude is None:
        return None
    angles = flight.attitude.roll_pitch_yaw_rad
    known = np.isfinite(angles).all(axis=1)
    if known.sum() < FEWEST or len(flight.imu.stamps_s) < FEWEST:
        return None
    turned, stamps = np.unwrap(angles[known], axis=0), flight.attitude.stamps_s[known]
    imu_s = flight.imu.stamps_s
    at_imu = np.column_stack([np.interp(imu_s, stamps, column) for column in turned.T])
    seen = ImuReadings(
        imu_s, **in_body_axes(flight), angles=at_imu, w_R_b=rotation_of(at_imu), lags=lags or {}
    )
    if seen.lags.get("attitude", PROMPT) == PROMPT:
        return seen
    turned_by = seen.integral(seen.turn)
    at_imu = at_imu + turned_by - seen.lagged("attitude", turned_by)
    return replace(seen, angles=at_imu, w_R_b=rotation_of(at_imu))


def in_body_axes(flight: Flight) -> dict[str, Array]:
    """Return the readings (n, 3) of the imu. A term of the imu changes them, and neither stamps nor
    attitude."""
    assert flight.imu is not None
    b_R_s = flight.imu.b_T_s[:3, :3]
    return {"gyro": flight.imu.gyro_rad_s @ b_R_s.T, "accel": flight.imu.accel_m_s2 @ b_R_s.T}


def _attitude(flight: Flight, imu: ImuReadings) -> IntegralComparison | None:
    assert flight.attitude is not None
    known = np.isfinite(flight.attitude.roll_pitch_yaw_rad).all(axis=1)
    stamps = flight.attitude.stamps_s[known]
    angles = np.unwrap(flight.attitude.roll_pitch_yaw_rad[known], axis=0)
    turn = imu.turn

    def others() -> dict[str, Array]:
        return {BETWEEN_SAMPLES: imu.at(stamps, _jumps(imu, turn))}

    turned_by = imu.at(stamps, imu.lagged("attitude", imu.integral(turn)))
    return IntegralComparison(stamps, angles, turned_by, 1, angles[:, 2], others)


def _jumps(imu: ImuReadings, rate: Array) -> Array:
    """Return (n, k) the sum of the jumps of a rate (n, k) so far, each times its sampling interval, or the
    usual one where stamps that scatter shorten it."""
    change = np.diff(rate, axis=0)
    apart = change - median_filter(change, (5, 1))
    apart[np.abs(apart) < JUMP * np.array([robust_std(a) for a in apart.T])] = 0.0
    apart_s = np.diff(imu.stamps_s)
    worth = np.maximum(apart_s, np.median(apart_s))[:, None] * apart
    return np.vstack([np.zeros(rate.shape[1]), np.cumsum(worth, axis=0)])


def _velocity(flight: Flight, imu: ImuReadings) -> IntegralComparison | None:
    if flight.velocity is None:
        return None
    good = np.isfinite(flight.velocity.v_m_s).all(axis=1)
    stamps, read = flight.velocity.stamps_s[good], flight.velocity.v_m_s[good]
    if good.sum() < FEWEST:
        return None
    yaw = imu.at(stamps, imu.lagged("velocity", imu.angles[:, 2:]))[:, 0]
    gained = imu.lagged("velocity", imu.integral(_acceleration(imu))[:, :2])
    return IntegralComparison(stamps, into_world(yaw, read), imu.at(stamps, gained), 1, yaw)


def _height(flight: Flight, imu: ImuReadings) -> IntegralComparison | None:
    if flight.sonar is None:
        return None
    good = np.isfinite(flight.sonar.range_m)
    stamps, read = flight.sonar.stamps_s[good], flight.sonar.range_m[good]
    if good.sum() < FEWEST:
        return None
    angles = imu.at(stamps, imu.angles)
    up = rotation_of(angles)[:, 2]
    height = read * (up @ flight.sonar.b_T_s[:3, 2])
    risen = imu.at(stamps, imu.integral(imu.integral(_acceleration(imu))[:, 2:]))
    return IntegralComparison(stamps, height[:, None], risen, 2, angles[:, 2])


_COMPARISONS = {"attitude": _attitude, "velocity": _velocity, "height": _height}
READ_AS = {"attitude": "attitude", "velocity": "velocity", "height": "sonar"}
"""Kind -> stream that is compared with the imu."""


def _acceleration(imu: ImuReadings) -> Array:
    """Return (n, 3) acceleration in the world."""
    return np.asarray(imu.w_accel - [0.0, 0.0, GRAVITY_M_S2])


def near_floor(flight: Flight) -> Array:
    """Return stamps of ranges that are missing, or so small that the vehicle may stand."""
    if flight.sonar is None:
        return np.zeros(0)
    near = ~(flight.sonar.range_m > LOWEST_M)
    return flight.sonar.stamps_s[near]


def into_world(yaw: Array, ahead_left: Array) -> Array:
    """Return (n, 2) east and north of a velocity ahead and to the left."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = ahead_left.T
    return np.column_stack([c * x - s * y, s * x + c * y])


def _angle_rates(angles: Array) -> Array:
    """Return (n, 3, 3) matrices from body rates to rates of roll, pitch and yaw."""
    (sr, cr), pitch = (np.sin(angles[:, 0]), np.cos(angles[:, 0])), angles[:, 1]
    zero, one = np.zeros(len(pitch)), np.ones(len(pitch))
    rows = [
        [one, sr * np.tan(pitch), cr * np.tan(pitch)],
        [zero, cr, -sr],
        [zero, sr / np.cos(pitch), cr / np.cos(pitch)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


class ComparisonMoments(NamedTuple):
    """ComparisonMoments ``NODE_S`` apart, about which readings are averaged."""

    times_s: Array
    """(n,)."""
    begin: Ints
    """(n,) first reading about a moment, ..."""
    end: Ints
    """... and the one after the last."""
    whole: NDArray[np.bool_]
    """(n,) whether there are readings about a moment, none of them near the floor."""

    def means(self, table: Array) -> Array:
        """Return (n, columns) means about each moment, less those of all rows of the table."""
        total = np.vstack([np.zeros(table.shape[1]), np.cumsum(table - table.mean(axis=0), axis=0)])
        count = np.maximum(self.end - self.begin, 1)
        return np.asarray((total[self.end] - total[self.begin]) / count[:, None])

    def together(self, order: int) -> NDArray[np.bool_]:
        """Return (n - order,) whether a moment and the ``order`` ones after it are whole."""
        count = len(self.whole) - order
        return np.asarray(np.all([self.whole[k : count + k] for k in range(order + 1)], axis=0))


def moments_of(stamps: Array, near_floor: Array) -> ComparisonMoments:
    """Return the moments of a stream with stamps (n,); ``near_floor`` (m,) are stamps of low ranges."""
    nodes = np.arange(stamps[0] + ABOUT_S, stamps[-1] - ABOUT_S - ROUNDING_S, NODE_S)
    edges = nodes - ROUNDING_S
    begin, end = (np.searchsorted(stamps, edges + side) for side in (-ABOUT_S, ABOUT_S))
    low = np.searchsorted(near_floor, edges + 2 * ABOUT_S) - np.searchsorted(near_floor, edges - 2 * ABOUT_S)
    return ComparisonMoments(nodes, begin, end, (end - begin >= 2) & (low == 0))


def segment_numbers(times_s: Array, begin_s: Array | float, segment_s: float) -> Ints:
    """Return (n,) the number of the segment of each time, counted from ``begin_s``."""
    return np.floor((times_s - begin_s + ROUNDING_S) / segment_s).astype(np.int64)


@dataclass(frozen=True)
class Averages:
    """One component of a comparison, at moments ``NODE_S`` apart."""

    channel: str
    unit: str
    order: int
    """Number of integrations of the imu."""
    times_s: Array
    """(n,)."""
    whole: NDArray[np.bool_]
    """(n,) whether there are readings about a moment, none of them near the floor."""
    pause: Ints
    """(n,) number of gaps before the moment."""
    names: list[str]
    """Names of the table's columns after its first."""
    table: Array
    """(n, 1 + columns) reading less integral, and its derivative by each effect."""

    def column(self, name: str) -> int:
        """Return the index of a column in the table; of a scale, that of the integrated quantity."""
        return 1 + self.names.index(name + INTEGRATED if name + INTEGRATED in self.names else name)

    def ahead(self, horizon_s: float) -> tuple[Array, NDArray[np.bool_]]:
        """Return (m, 1 + columns) by how much the table misses what it predicts a horizon ahead, from each of
        the first m moments, and (m,) whether there are readings all the while.

        A second integral is predicted from the moment and from the middle of the horizon.
        """
        ahead = round(horizon_s / NODE_S)
        last = len(self.times_s) - ahead
        if last < 1 or ahead % self.order:
            return self.table[:0], self.whole[:0]
        lost = np.concatenate([[0], np.cumsum(~self.whole)])
        kept = (lost[ahead + 1 :] == lost[:last]) & (self.pause[ahead:] == self.pause[:last])
        apart = self.table[ahead:] - self.table[:last]
        if self.order == 2:
            apart -= 2.0 * (self.table[ahead // 2 : last + ahead // 2] - self.table[:last])
        return apart, kept
