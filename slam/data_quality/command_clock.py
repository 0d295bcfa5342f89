"""Check that a vehicle answers its commands at the logged times.

Stamps of reception may come seconds late, for a whole flight or for one burst of a link. No model can be
judged on such a log.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.core.recursion import recursion
from slam.data_quality.channels import streams_of
from slam.data_quality.commands import has_commands
from slam.data_quality.dead_streams import FEWEST_READINGS
from slam.simulation.stick import Stick, stick_of

Array = NDArray[np.float64]

GRID_S = 0.02
REACH_S = 5.0
"""Greatest delay or lead at which a response is sought."""
LONGEST_GAP_S = 5.0
"""The flight is compared up to the first longer gap between readings."""
EARLIEST_S, LATEST_S = -0.3, 0.8
"""Plausible range of a response: latency, lag, and the scatter of stamps."""
WINDOW_S, HOP_S = 6.0, 2.0
LEAST_ASKED = 0.05
"""Least demand in a window, as a share of the flight's largest."""
TILT_LAG_S = 0.1
"""Approximate lag of a healthy vehicle. Delays of seconds need no better figure."""
ALIKE, ALIKE_IN_WINDOW = 0.3, 0.7
"""Least squared correlation of command and response, in a flight and in a window, where chance reaches
more."""
LEADS = 2.5
"""Least ratio to the greatest squared correlation at a plausible time."""


@dataclass(frozen=True)
class ClockError:
    """A response at an implausible time."""

    late_s: float
    """Delay after the command; negative where the response comes before it."""
    at_s: float | None
    """Begin of the window, from the first reading; None for the flight as a whole."""

    def __str__(self) -> str:
        """Return a description of one line."""
        when = "all along" if self.at_s is None else f"from {self.at_s:.0f} s on"
        side = "after" if self.late_s > 0 else "before"
        return (
            f"{when} the vehicle answers {abs(self.late_s):.1f} s {side} its commands: the command log is on "
            "another clock"
        )


def clock_error(flight: Flight) -> ClockError | None:
    """Return the clearest response at an implausible time, or None.

    Tilts are compared, read by the attitude or else by the gyro. The whole flight is tested first, then
    windows. Flights without commands or readings have no response.
    """
    stamps_s = _stamps_s(flight)
    if flight.command is None or not has_commands(flight) or len(stamps_s) == 0:
        return None
    times_s = np.arange(stamps_s[0], stamps_s[-1], GRID_S)
    if len(times_s) < 2:
        return None
    answers = _answers(flight, stick_of(flight.command, float(stamps_s[-1])), times_s)
    found = [error for pair in answers for error in _implausible(*pair, ALIKE, None)]
    found = found or [error for pair in answers for error in _in_windows(*pair)]
    return max(found, key=lambda f: f[0], default=(0.0, None))[1]


def _stamps_s(flight: Flight) -> Array:
    """Return the increasing stamps of all readings up to the first long gap."""
    finite = (stream.stamps_s[np.isfinite(stream.values).any(axis=1)] for stream in streams_of(flight))
    stamps_s = np.sort(np.concatenate([np.zeros(0), *finite]))
    gaps = np.flatnonzero(np.diff(stamps_s) > LONGEST_GAP_S)
    return stamps_s[: int(gaps[0]) + 1] if len(gaps) else stamps_s


def _answers(flight: Flight, stick: Stick, times_s: Array) -> list[tuple[Array, Array]]:
    """Return pairs of demanded and measured tilt, or else its rate, on one grid. The measured one is extended
    by ``REACH_S`` at both ends."""
    asked = stick.mean(times_s, times_s + GRID_S)[:, :2]
    decay = float(np.exp(-GRID_S / TILT_LAG_S))
    tilt = recursion((1.0 - decay) * asked, decay)
    read_by: list[tuple[Array, Array, Array]] = []
    if (attitude := flight.attitude) is not None:
        read_by.append((attitude.stamps_s, attitude.roll_pitch_yaw_rad, tilt))
    if (imu := flight.imu) is not None:
        gyro = np.where(np.isfinite(imu.gyro_rad_s), imu.gyro_rad_s, np.nan) @ imu.b_T_s[:3, :3].T
        read_by.append((imu.stamps_s, gyro, np.gradient(tilt, GRID_S, axis=0)))
    pairs = []
    for axis, column, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        for stamps_s, values, demanded in read_by:
            rows = np.isfinite(values[:, column]) & (stamps_s <= times_s[-1] + GRID_S)
            if rows.sum() >= FEWEST_READINGS:
                read = np.interp(times_s, stamps_s[rows], values[rows, column])
                pairs.append((sign * demanded[:, axis], np.pad(read, round(REACH_S / GRID_S), mode="edge")))
                break
    return [pair for pair in pairs if np.ptp(pair[0]) > 0.0]


def _in_windows(asked: Array, answer: Array) -> list[tuple[float, ClockError]]:
    length, hop, reach = round(WINDOW_S / GRID_S), round(HOP_S / GRID_S), round(REACH_S / GRID_S)
    found = []
    for begin in range(0, len(asked) - length, hop):
        part = asked[begin : begin + length]
        if np.ptp(part) > LEAST_ASKED * np.ptp(asked):
            near = answer[begin : begin + length + 2 * reach]
            found += _implausible(part, near, ALIKE_IN_WINDOW, begin * GRID_S)
    return found


def _implausible(
    asked: Array, answer: Array, least: float, at_s: float | None
) -> list[tuple[float, ClockError]]:
    """Return the response with its squared correlation where it comes at an implausible time; else
    nothing."""
    n = len(asked)
    centred = asked - asked.mean()
    sums = [np.cumsum(np.pad(x, (1, 0))) for x in (answer, answer**2)]
    mean, square = ((s[n:] - s[:-n]) / n for s in sums)
    spread = np.sqrt(n * np.maximum(square - mean**2, 0.0))
    alike = np.correlate(answer, centred, mode="valid") / np.maximum(np.linalg.norm(centred) * spread, 1e-12)
    late_s = GRID_S * (np.arange(len(alike)) - len(alike) // 2)
    squared = np.maximum(alike, 0.0) ** 2
    plausible = (late_s >= EARLIEST_S) & (late_s <= LATEST_S)
    best = int(np.argmax(squared))
    if plausible[best] or squared[best] < max(least, LEADS * squared[plausible].max()):
        return []
    return [(float(squared[best]), ClockError(float(late_s[best]), at_s))]
