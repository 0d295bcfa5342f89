"""Jumps: a reading that changes at one moment, and stays so, where the imu's integral does not.

A filter that is reset, or an estimate that finds its heading late, reads like that. Comparisons over half a
second take one such change for an outlier.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from frontend.robust import NORMAL, robust_std
from slam.core.arrays import Array, Ints, Mask
from slam.core.flight import Flight
from slam.data_quality.axes import INTEGRAL, WAYS
from slam.data_quality.channels import streams_of
from slam.data_quality.comparison_derivatives import derivatives, usual_size
from slam.data_quality.finding import Finding, flights_to_name
from slam.data_quality.inertial_comparison import (
    FEWEST,
    INTEGRATED,
    LONGEST_GAP_S,
    LOWEST_M,
    NODE_S,
    READ_AS,
    ROUNDING_S,
    IntegralComparison,
    comparisons,
    imu_of,
    with_finite_imu,
)
from slam.data_quality.lag import Lag

LEAST_RATIO = 6.0
"""Least jump in standard deviations of all changes, no less than those of a median of readings."""
AHEAD, MOST_JUMPS = 1.5, 10
"""Least ratio of a jump to what else is greatest in its flight, and most jumps of a channel. For attitude and
velocity it is up to 1.3 on measured flights without a jump, and 2.2 and more with a jump of 1 m/s."""
LEAST_LOCAL = 5.0
"""Least jump in standard deviations of the medians by the scatter of their own readings: a noise may grow."""
MEDIAN = 1.2533
"""Standard deviation of a median over that of a mean, the root of pi / 2."""
STEP_S = 0.1
"""Spacing of the moments that are tried."""
FEWEST_READINGS, READINGS = 3, 5
"""Least number of readings on either side, and the number that is enough."""
REJECTED, FIT_ROUNDS = 4.7, 5
"""Rejection limit in robust standard deviations (Tukey's biweight), and rounds of the fit."""
TINY = 1e-12


@dataclass(frozen=True)
class Jump(Finding):
    """The greatest jump of a channel. A range jumps with the sonar's zero, or with the floor."""

    size: float
    unit: str
    time_s: float
    count: int
    """Number of jumps of this channel."""

    @property
    def is_shown_otherwise(self) -> bool:
        """Whether it may be steps of the floor, because a range jumps more than once: the zero of a sonar
        jumps once. With commands, such steps are a cause of their own."""
        return self.channel == "range" and self.count > 1

    def _text(self) -> str:
        by = INTEGRAL["attitude" if self.channel in WAYS["attitude"] else "velocity"]
        others = f"; it does so {self.count} times" if self.count > 1 else ""
        change = f"{self.size:.3g} {self.unit} at {self.time_s:.1f} s"
        floor = ", as over steps of the floor" if self.is_shown_otherwise else ""
        return f"{self.channel} jumps by {change}, where the {by} shows no such change{others}{floor}"


def jumps_of_all(flights: Sequence[Flight], lags: Mapping[str, Lag]) -> list[Jump]:
    """Return the jumps of all flights, beside the lags of their streams."""
    names = flights_to_name([flight.name for flight in flights])
    return [replace(jump, flight=n) for n, f in zip(names, flights, strict=True) for jump in jumps(f, lags)]


def jumps(flight: Flight, lags: Mapping[str, Lag] | None = None) -> list[Jump]:
    """Return the jumps of the flight's attitude, velocity and range, the greatest of each channel.

    The integral is wrong near the floor and over gaps of imu and attitude: no jump is told there. Nor is any
    of velocity and range where the attitude jumps, because it turns both comparisons into the world, nor one
    of the range where the velocity jumps.
    """
    noise_std = {stream.name: float(stream.noise_std.max()) for stream in streams_of(flight)}
    wrong_s, found = _wrong_integral(flight), []
    for kind, seen in comparisons(flight, lags):
        moments = _moments_of(seen, wrong_s)
        if len(moments.times_s) < FEWEST:
            continue
        changes = _unexplained(flight, kind, seen, lags, moments)
        # A median of many readings is so much more certain than one of them.
        noise = MEDIAN * noise_std[READ_AS[kind]] / np.sqrt(moments.readings)
        local_std = moments.local_std(seen, _uncertain(flight))
        for channel, unit, scale, part in _channels(kind, changes):
            size = np.linalg.norm(part, axis=1)
            peaks = _peaks(moments.times_s, size, max(_std(part), noise, TINY))
            peaks = peaks[size[peaks] > LEAST_LOCAL * local_std[peaks]]
            if len(peaks):
                at_s, most = moments.times_s[peaks], scale * float(size[peaks[0]])
                wrong_s = np.hstack([wrong_s, np.tile(at_s, (2, 1))])
                found.append(Jump(most, unit, float(at_s[0]), len(peaks), channel=channel))
    return found


def _std(part: Array) -> float:
    return float(np.sqrt(np.mean([robust_std(column) ** 2 for column in part.T])))


def _peaks(times_s: Array, size: Array, std: float) -> Ints:
    """Return the indices of the moments (n,) at which a channel jumps, the greatest jump first.

    Changes of a flight in gusts have heavy tails, and no fixed limit holds for them: jumps exceed whatever is
    greatest among the others.
    """
    left, peaks = size.copy(), list[int]()
    while len(peaks) <= MOST_JUMPS and left.max() > 0.0:
        peaks.append(int(np.argmax(left)))
        left[np.abs(times_s - times_s[peaks[-1]]) <= 2.0 * NODE_S] = 0.0
    if not peaks:
        return np.zeros(0, dtype=np.int64)
    sizes = np.append(size[peaks], 0.0)
    ahead = sizes[:-1] / np.maximum(sizes[1:], LEAST_RATIO * std / AHEAD)
    ahead[MOST_JUMPS:] = 0.0
    count = int(np.argmax(ahead)) + 1
    return np.array(peaks[:count] if ahead[count - 1] > AHEAD else [], dtype=np.int64)


def _unexplained(
    flight: Flight, kind: str, seen: IntegralComparison, lags: Mapping[str, Lag] | None, moments: _Moments
) -> Array:
    """Return the changes (n, components) of readings less integral, without what errors of the instruments of
    usual sizes make of them: a late reading of a sudden motion looks like a jump there and back."""
    finite = with_finite_imu(flight)
    imu = imu_of(finite, lags)
    assert imu is not None
    changes, columns = moments.changes_of_medians(seen.off), derivatives(finite, imu, kind, seen.off)
    # What is made of the reading itself has the jump in it.
    usual = {name: usual_size(name) for name in columns if name + INTEGRATED not in columns}
    made = [moments.changes_of_means(size * columns[name]) for name, size in usual.items()]
    tables = (np.column_stack([column[:, k] for column in made]) for k in range(changes.shape[1]))
    return np.column_stack([_left(change, table) for change, table in zip(changes.T, tables, strict=True)])


def _left(change: Array, table: Array) -> Array:
    """Return what is left of changes (n,) by a robust fit of columns in units of their usual sizes: a jump is
    no reason for an error, and what an error makes of many motions it makes of a sudden one, too."""
    left, zeros, weight = change, np.zeros(table.shape[1]), np.ones(len(change))
    for _ in range(FIT_ROUNDS):
        std = max(robust_std(left), TINY)
        weighted = np.vstack([weight[:, None] * table, std * np.eye(len(zeros))])
        left = change - table @ np.linalg.lstsq(weighted, np.append(weight * change, zeros), rcond=None)[0]
        weight = np.clip(1.0 - (left / (REJECTED * max(robust_std(left), TINY))) ** 2, 0.0, None)
    return left


def _uncertain(flight: Flight) -> float:
    """Return the standard deviation of a moment between two samples of the gyro and of their stamps, as a
    share of the usual time between them."""
    imu = with_finite_imu(flight).imu
    assert imu is not None
    apart_s = np.diff(imu.stamps_s)
    return math.hypot(12.0**-0.5, robust_std(apart_s) / math.sqrt(2.0) / max(float(np.median(apart_s)), TINY))


def _wrong_integral(flight: Flight) -> Array:
    """Return the begins and ends (2, n) of spans over which the integral of the imu is wrong."""
    imu = with_finite_imu(flight).imu
    stamps = np.concatenate([[-np.inf], imu.stamps_s if imu is not None else [], [np.inf]])
    gaps = np.flatnonzero(np.diff(stamps) > LONGEST_GAP_S)
    spans_s = np.array([stamps[gaps], stamps[gaps + 1]])
    if flight.attitude is not None:
        known_s = flight.attitude.stamps_s[np.isfinite(flight.attitude.roll_pitch_yaw_rad).all(axis=1)]
        known_s = np.concatenate([[-np.inf], known_s, [np.inf]])
        gaps = np.flatnonzero(np.diff(known_s) > NODE_S)
        spans_s = np.hstack([spans_s, [known_s[gaps], known_s[gaps + 1]]])
    if flight.sonar is None:
        return spans_s
    low_s = flight.sonar.stamps_s[flight.sonar.range_m <= LOWEST_M]
    return np.hstack([spans_s, [low_s, low_s]])


def _channels(kind: str, changes: Array) -> list[tuple[str, str, float, Array]]:
    """Return the channels of a comparison: name, unit, that unit in SI units, and changes (n, components).

    The axes of a velocity turn with the vehicle, so its components are one channel.
    """
    if kind != "attitude":
        return [("velocity", "m/s", 1.0, changes)] if kind == "velocity" else [("range", "m", 1.0, changes)]
    return [(way, "deg", float(np.degrees(1.0)), changes[:, [k]]) for k, way in enumerate(WAYS[kind])]


@dataclass(frozen=True)
class _Moments:
    """Moments at which a stream may jump, and the readings before and after them."""

    times_s: Array
    """(n,)."""
    edges: Ints
    """(moments, 3) first readings of the times before and after each moment, and the end."""
    known: Ints
    """(n,) which of the moments, less those near either end, are judged."""
    beside: int
    """Number of moments in the time before, and after, each of them."""

    @property
    def readings(self) -> float:
        """Usual number of readings before, or after, a moment."""
        return max(float(np.median(np.diff(self.edges))), 1.0)

    def changes_of_medians(self, off: Array) -> Array:
        """Return (n, components) by how much differences ``off`` change at the moments, beside the times
        before and after. Medians do not follow single readings, and what drifts does so there too."""
        steps = np.full((len(self.edges), off.shape[1]), np.nan)
        for k in np.flatnonzero(_are_enough(self.edges)).tolist():
            begin, middle, end = self.edges[k]
            steps[k] = np.median(off[middle:end], axis=0) - np.median(off[begin:middle], axis=0)
        return self._beside(steps)

    def local_std(self, seen: IntegralComparison, uncertain: float) -> Array:
        """Return (n,) the standard deviation of each change, by the scatter of the readings and by rates
        that jump at an unknown time, a share ``uncertain`` of the time between two samples of the gyro."""
        variance = np.full(len(self.edges), np.inf)
        for k in np.flatnonzero(_are_enough(self.edges)).tolist():
            begin, _, end = self.edges[k]
            each = np.diff(seen.off[begin:end], axis=0)
            each = NORMAL * np.median(np.abs(each - np.median(each, axis=0)), axis=0)
            # Half the variance of a difference is that of a reading; two medians are of n / 2 readings each.
            variance[k] = 2.0 * MEDIAN**2 * float(0.5 * each @ each) / (0.5 * (end - begin))
        for between in seen.others().values():
            jumped = np.cumsum(np.sum(np.diff(between, axis=0, prepend=between[:1]) ** 2, axis=1))
            jumped = np.append(0.0, uncertain**2 * jumped)
            variance += jumped[self.edges[:, 2]] - jumped[self.edges[:, 0]]
        return np.asarray(np.sqrt(1.5 * variance[self.beside : -self.beside][self.known]))

    def changes_of_means(self, signal: Array) -> Array:
        """Return the same of a signal without noise, of which a mean is enough."""
        total = np.vstack([np.zeros(signal.shape[1]), np.cumsum(signal, axis=0)])
        sums, counts = np.diff(total[self.edges], axis=1), np.diff(self.edges)[:, :, None]
        means = sums / np.maximum(counts, 1)
        return self._beside(means[:, 1] - means[:, 0])

    def _beside(self, steps: Array) -> Array:
        inner = steps[self.beside : -self.beside]
        return np.asarray(inner - 0.5 * (steps[2 * self.beside :] + steps[: -2 * self.beside]))[self.known]


def _are_enough(edges: Ints) -> Mask:
    return np.asarray(np.diff(edges).min(axis=1) >= FEWEST_READINGS)


def _moments_of(seen: IntegralComparison, wrong_s: Array) -> _Moments:
    """Return the moments of a stream beside an integral, none near spans ``wrong_s`` (2, m).

    A double integral is off by the square of the time: it is compared over as few readings as are enough. A
    slow sensor is logged several times a reading.
    """
    stamps, usual_s = seen.stamps_s, NODE_S
    if seen.order > 1:
        new_s = stamps[1:][np.any(np.diff(seen.read, axis=0) != 0.0, axis=1)]
        usual_s = READINGS * float(np.median(np.diff(new_s))) if len(new_s) > 1 else NODE_S
    beside = min(max(math.ceil(usual_s / STEP_S), 2), round(NODE_S / STEP_S))
    window_s = beside * STEP_S
    times_s = np.arange(stamps[0] + window_s, stamps[-1] - window_s, STEP_S)
    edges = np.column_stack(
        [np.searchsorted(stamps, times_s + side - ROUNDING_S) for side in (-window_s, 0.0, window_s)]
    )
    if len(times_s) <= 2 * beside:
        return _Moments(np.zeros(0), edges, np.zeros(0, dtype=np.int64), beside)
    enough, inner_s = _are_enough(edges), times_s[beside:-beside]
    reach_s = 2.0 * NODE_S + LONGEST_GAP_S
    begins_s, ends_s = np.sort(wrong_s, axis=1)
    begun, ended = np.searchsorted(begins_s, inner_s + reach_s), np.searchsorted(ends_s, inner_s - reach_s)
    whole = enough[beside:-beside] & enough[2 * beside :] & enough[: -2 * beside]
    known = np.flatnonzero(whole & (begun == ended))
    return _Moments(inner_s[known], edges, known, beside)
