"""Jumps: a reading that changes at one moment, and stays so, where the imu's integral does not.

A filter that is reset, or an estimate that finds its heading late, reads like that. Comparisons over half a
second take one such change for an outlier.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.data_quality.axes import INTEGRAL, WAYS
from slam.data_quality.channels import streams_of
from slam.data_quality.finding import Finding, flights_to_name
from slam.data_quality.inertial_comparison import (
    FEWEST,
    LONGEST_GAP_S,
    LOWEST_M,
    NODE_S,
    ROUNDING_S,
    IntegralComparison,
    comparisons,
    with_finite_imu,
)
from slam.data_quality.lag import Lag

Array = NDArray[np.float64]

LEAST_RATIO = 10.0
"""Least jump in standard deviations of all changes, no less than those stated of one reading. On measured
flights without one the greatest is 8.8, as tails are heavy; jumps of 1 m/s in their velocity are 10 to 33."""
STEP_S = 0.1
"""Spacing of the moments that are tried."""
FEWEST_READINGS = 3
"""Least number of readings on either side."""


@dataclass(frozen=True)
class Jump(Finding):
    """The greatest jump of a channel."""

    size: float
    unit: str
    time_s: float
    count: int
    """Number of jumps of this channel."""

    def _text(self) -> str:
        by = INTEGRAL["attitude" if self.channel in WAYS["attitude"] else "velocity"]
        others = f"; it does so {self.count} times" if self.count > 1 else ""
        change = f"{self.size:.3g} {self.unit} at {self.time_s:.1f} s"
        return f"{self.channel} jumps by {change}, where the {by} shows no such change{others}"


def jumps_of_all(flights: Sequence[Flight], lags: Mapping[str, Lag]) -> list[Jump]:
    """Return the jumps of all flights, beside the lags of their streams."""
    names = flights_to_name([flight.name for flight in flights])
    return [replace(jump, flight=n) for n, f in zip(names, flights, strict=True) for jump in jumps(f, lags)]


def jumps(flight: Flight, lags: Mapping[str, Lag] | None = None) -> list[Jump]:
    """Return the jumps of the flight's attitude and velocity, the greatest of each channel.

    The integral is wrong near the floor and over gaps of imu and attitude: no jump is told there. Where the
    attitude jumps, none of the velocity is told, because the attitude turns the velocity into the world.
    """
    noise_std = {stream.name: float(stream.noise_std.max()) for stream in streams_of(flight)}
    wrong_s, found = _wrong_integral(flight), []
    for kind, seen in comparisons(flight, lags):
        if kind == "height":
            continue  # a floor may have steps
        times_s, changes = _changes(seen, wrong_s)
        if len(times_s) < FEWEST:
            continue
        for channel, unit, scale, part in _channels(kind, changes):
            std = float(np.sqrt(np.mean([robust_std(column) ** 2 for column in part.T])))
            size = np.linalg.norm(part, axis=1)
            beyond = np.flatnonzero(size > LEAST_RATIO * max(std, noise_std[kind], 1e-9))
            if len(beyond):
                wrong_s = np.hstack([wrong_s, np.tile(times_s[beyond], (2, 1))])
                k, count = int(np.argmax(size)), 1 + int(np.sum(np.diff(times_s[beyond]) > NODE_S))
                found.append(Jump(scale * float(size[k]), unit, float(times_s[k]), count, channel=channel))
    return found


def _wrong_integral(flight: Flight) -> Array:
    """Return the begins and ends (2, n) of spans over which the integral of the imu is wrong."""
    imu = with_finite_imu(flight).imu
    stamps = np.concatenate([[-np.inf], imu.stamps_s if imu is not None else [], [np.inf]])
    gaps = np.flatnonzero(np.diff(stamps) > LONGEST_GAP_S)
    spans_s = np.array([stamps[gaps], stamps[gaps + 1]])
    if flight.attitude is not None:
        known_s = flight.attitude.stamps_s[np.isfinite(flight.attitude.roll_pitch_yaw_rad).all(axis=1)]
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
    if kind == "velocity":
        return [("velocity", "m/s", 1.0, changes)]
    return [(way, "deg", float(np.degrees(1.0)), changes[:, [k]]) for k, way in enumerate(WAYS[kind])]


def _changes(seen: IntegralComparison, wrong_s: Array) -> tuple[Array, Array]:
    """Return moments (n,), and (n, components) by how much the readings' difference from the integral changes
    there, beside the half seconds before and after; without moments near spans ``wrong_s`` (2, m).

    Medians do not follow single readings, and what drifts does so before and after as well.
    """
    stamps, off = seen.stamps_s, seen.off
    times_s = np.arange(stamps[0] + NODE_S, stamps[-1] - NODE_S, STEP_S)
    edges = [np.searchsorted(stamps, times_s + side - ROUNDING_S) for side in (-NODE_S, 0.0, NODE_S)]
    steps = np.full((len(times_s), off.shape[1]), np.nan)
    for k, (begin, middle, end) in enumerate(zip(*edges, strict=True)):
        if min(middle - begin, end - middle) >= FEWEST_READINGS:
            steps[k] = np.median(off[middle:end], axis=0) - np.median(off[begin:middle], axis=0)
    beside = round(NODE_S / STEP_S)
    inner = slice(beside, max(len(times_s) - beside, beside))
    changes = steps[inner] - 0.5 * (steps[2 * beside :] + steps[: max(len(steps) - 2 * beside, 0)])
    reach_s = 2.0 * NODE_S + LONGEST_GAP_S
    begins_s, ends_s = np.sort(wrong_s, axis=1)
    begun = np.searchsorted(begins_s, times_s[inner] + reach_s)
    ended = np.searchsorted(ends_s, times_s[inner] - reach_s)
    known = np.isfinite(changes).all(axis=1) & (begun == ended)
    return times_s[inner][known], changes[known]
