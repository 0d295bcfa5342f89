"""Jumps: a reading that changes at one moment, and stays so, where the imu's integral does not.

A filter that is reset, or an estimate that finds its heading late, reads like that. Comparisons over half a
second take one such change for an outlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.core.flight import Flight
from slam.data_quality.channels import streams_of
from slam.data_quality.finding import Finding, flights_to_name
from slam.data_quality.inertial_comparison import (
    FEWEST,
    LOWEST_M,
    NODE_S,
    ROUNDING_S,
    IntegralComparison,
    comparisons,
    with_finite_imu,
)

Array = NDArray[np.float64]

LEAST_RATIO = 10.0
"""Least jump in standard deviations of all changes, no less than those stated of one reading. On measured
flights without one the greatest is 8.8, as tails are heavy; jumps of 1 m/s in their velocity are 10 to 33."""
STEP_S = 0.1
"""Spacing of the moments that are tried."""
LONGEST_GAP_S = 0.15
"""Longest time between samples of the imu that its integral may bridge."""
FEWEST_READINGS = 3
"""Least number of readings on either side."""
COMPONENTS = {"attitude": ("roll", "pitch", "yaw"), "velocity": ("velocity",)}
UNITS = {"attitude": "deg", "velocity": "m/s"}


@dataclass(frozen=True)
class Jump(Finding):
    """The greatest jump of a channel."""

    size: float
    unit: str
    time_s: float
    count: int
    """Number of jumps of this channel."""

    def _text(self) -> str:
        by = "gyro" if self.unit == "deg" else "accelerometer"
        others = f"; so it does {self.count} times" if self.count > 1 else ""
        change = f"{self.size:.3g} {self.unit} at {self.time_s:.1f} s"
        return f"{self.channel} jumps by {change}, where the {by} shows no such change{others}"


def jumps_of_all(flights: Sequence[Flight]) -> list[Jump]:
    """Return the jumps of all flights."""
    names = flights_to_name([flight.name for flight in flights])
    return [replace(jump, flight=n) for n, f in zip(names, flights, strict=True) for jump in jumps(f)]


def jumps(flight: Flight) -> list[Jump]:
    """Return the jumps of the flight's attitude and velocity, one for each channel.

    Near the floor an integral does not tell, nor where the imu has gaps; and not what the velocity does where
    the attitude jumps, by which it is turned.
    """
    finite = with_finite_imu(flight)
    if finite.imu is None or not len(finite.imu.stamps_s):
        return []
    stamps = np.concatenate([[-np.inf], finite.imu.stamps_s, [np.inf]])
    gaps = np.flatnonzero(np.diff(stamps) > LONGEST_GAP_S)
    doubted_s = np.array([stamps[gaps], stamps[gaps + 1]])
    if flight.sonar is not None:
        low_s = flight.sonar.stamps_s[flight.sonar.range_m <= LOWEST_M]
        doubted_s = np.hstack([doubted_s, [low_s, low_s]])
    noise_std = {stream.name: max(float(stream.noise_std.max()), 1e-9) for stream in streams_of(flight)}
    found = []
    for kind, seen in comparisons(flight):
        if kind not in COMPONENTS:
            continue
        times_s, changes = _changes(seen, np.sort(doubted_s, axis=1))
        # The axes of a velocity turn with the vehicle: its components are judged together.
        parts = [changes] if kind == "velocity" else np.split(changes, 3, axis=1)
        scale = 1.0 if kind == "velocity" else float(np.degrees(1.0))
        for channel, part in zip(COMPONENTS[kind], parts, strict=True):
            if len(part) < FEWEST:
                continue
            std = float(np.linalg.norm([robust_std(column) for column in part.T])) / np.sqrt(part.shape[1])
            size = np.linalg.norm(part, axis=1)
            beyond = np.flatnonzero(size > LEAST_RATIO * max(std, noise_std[kind]))
            if len(beyond):
                doubted_s = np.hstack([doubted_s, np.tile(times_s[beyond], (2, 1))])
                k = int(np.argmax(size))
                apart = 1 + int(np.sum(np.diff(times_s[beyond]) > NODE_S))
                found.append(
                    Jump(scale * float(size[k]), UNITS[kind], float(times_s[k]), apart, channel=channel)
                )
    return found


def _changes(seen: IntegralComparison, doubted_s: Array) -> tuple[Array, Array]:
    """Return moments (n,), and (n, components) by how much the readings' difference from the integral changes
    there, beside the half seconds before and after; without moments near spans from ``doubted_s`` (2, m).

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
    begun = np.searchsorted(doubted_s[0], times_s[inner] + reach_s)
    known = np.isfinite(changes).all(axis=1) & (
        begun == np.searchsorted(doubted_s[1], times_s[inner] - reach_s)
    )
    return times_s[inner][known], changes[known]
