"""Whether a vehicle answers its commands when the log says that they were given.

Stamps of reception may come seconds late, for a whole flight or for one burst of a link. No model can be
judged by what then looks like a vehicle that does something else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from slam.criticism.kalman.readings import ATTITUDE, IMU
from slam.criticism.kalman.record import Record

Array = NDArray[np.float64]

GRID_S = 0.02
REACH_S = 5.0
"""How far from the command an answer is looked for."""
EARLIEST_S, LATEST_S = -0.3, 0.8
"""Between these a vehicle may answer: latency, lag, and stamps that scatter."""
WINDOW_S, HOP_S = 6.0, 2.0
LEAST_ASKED = 0.05
"""Of the flight's largest demand: what asks for less than this share is no question."""
TILT_LAG_S = 0.1
"""Of a healthy vehicle, roughly: what is late by seconds is not looked for by hundredths."""
ALIKE, ALIKE_IN_WINDOW = 0.3, 0.7
"""Squared correlation of command and answer that makes it one; in a window chance does more."""
LEADS = 2.5
"""Times as great as the greatest at a plausible time it must be."""
FEWEST_READINGS = 20
"""Of a stream: fewer tell nothing."""


@dataclass(frozen=True)
class ClockError:
    """An answer at no plausible time."""

    late_s: float
    """How long after its command, negative where before it."""
    at_s: float | None
    """Where the window begins, from the first reading; None for the flight as a whole."""

    def __str__(self) -> str:
        """For one line."""
        when = "all along" if self.at_s is None else f"from {self.at_s:.0f} s on"
        side = "after" if self.late_s > 0 else "before"
        return (
            f"{when} the vehicle answers {abs(self.late_s):.1f} s {side} its commands: the command log is on "
            "another clock"
        )


def clock_error(record: Record) -> ClockError | None:
    """The clearest answer at an implausible time, or None where there is none.

    Of tilts, read by the attitude or else by the gyro; of the whole flight where that is late.
    """
    times_s = np.arange(record.times_s[0], record.times_s[-1], GRID_S)
    if len(times_s) < 2:
        return None
    answers = _answers(record, times_s)
    found = [error for pair in answers for error in _implausible(*pair, ALIKE, None)]
    found = found or [error for pair in answers for error in _in_windows(*pair)]
    return max(found, key=lambda f: f[0], default=(0.0, None))[1]


def _answers(record: Record, times_s: Array) -> list[tuple[Array, Array]]:
    """What forward and left stick ask of pitch and roll, and what these did, on one grid: the latter held for
    ``REACH_S`` longer at both ends."""
    stick = record.stick.mean(times_s, times_s + GRID_S)[:, :2]
    decay = float(np.exp(-GRID_S / TILT_LAG_S))
    tilt = lfilter([1.0 - decay], [1.0, -decay], stick, axis=0)
    pairs = []
    for axis, column, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        for kind, asked in ((ATTITUDE, tilt[:, axis]), (IMU, np.gradient(tilt[:, axis], GRID_S))):
            rows = (record.kinds == kind) & np.isfinite(record.values[:, column])
            if rows.sum() >= FEWEST_READINGS:
                read = np.interp(times_s, record.times_s[rows], record.values[rows, column])
                pairs.append((sign * asked, np.pad(read, round(REACH_S / GRID_S), mode="edge")))
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
    """The answer with its squared correlation, where it comes at no plausible time; else nothing."""
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
