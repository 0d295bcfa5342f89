"""The stick as input of the equations: its mean over each interval.

With a mean instead of a sample, a change between two nodes counts for the part of the step in which it acts.
So the flight is a smooth function of the latency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.streams import Command

Array = NDArray[np.float64]

UNLOGGED_S = 10.0
"""Time before a log for which its first row is assumed, longer than any latency."""


@dataclass(frozen=True)
class Stick:
    """A stick that holds each value from its stamp to the next, and is 0 before the first."""

    stamps_s: Array
    """(n,) increasing stamps."""
    values: Array
    """(n, 4) commands forward, left, up, yaw."""
    duration_s: float
    """Duration of the flight, which ``battery_sag`` refers to."""
    begin_s: float = 0.0
    """Start of the flight."""

    def mean(self, begin_s: Array, end_s: Array, latency_s: float = 0.0) -> Array:
        """Return means over intervals (m, ``dynamics.COMMAND``) of the command, delayed by ``latency_s``."""
        begin, end = np.asarray(begin_s, dtype=float), np.asarray(end_s, dtype=float)
        length = np.maximum(end - begin, 1e-12)[:, None]
        mean = (self._integral(end - latency_s) - self._integral(begin - latency_s)) / length
        return np.column_stack([mean, self._discharge((begin + end) / 2)])

    def at(self, times_s: Array, latency_s: float = 0.0) -> Array:
        """Return the delayed command (m, ``dynamics.COMMAND``) at given times; at a change the new value."""
        times = np.asarray(times_s, dtype=float)
        values = np.vstack([np.zeros(4), self.values])
        k = np.searchsorted(self.stamps_s, times - latency_s, side="right")
        return np.column_stack([values[k], _centred(values)[k], self._discharge(times)])

    def pushes_s(self, begin_s: float, end_s: float) -> tuple[tuple[float, float], ...]:
        """Return begin and end of each time between two moments in which forward or left is not 0."""
        edges = np.clip(np.append(self.stamps_s, end_s), begin_s, end_s)
        pushed = _centred(self.values) == 0
        changes = np.flatnonzero(np.diff(np.concatenate([[False], pushed, [False]]).astype(int)))
        pairs = edges[changes].reshape(-1, 2)
        return tuple((float(begin), float(end)) for begin, end in pairs if end > begin)

    def _integral(self, times_s: Array) -> Array:
        """Return integrals (m, 5) of the stick and of ``centred``, from far before the first stamp."""
        first, last = self.stamps_s[0] - 1e4, self.stamps_s[-1] + 1e5
        nodes = np.concatenate([[first], self.stamps_s, [last]])
        values = np.vstack([np.zeros(4), self.values])
        height = np.column_stack([values, _centred(values)])
        total = np.vstack([np.zeros(5), np.cumsum(height * np.diff(nodes)[:, None], axis=0)])
        return np.column_stack([np.interp(times_s, nodes, column) for column in total.T])

    def _discharge(self, times_s: Array) -> Array:
        return np.clip((times_s - self.begin_s) / self.duration_s, 0.0, 1.0)


def stick_of(command: Command, duration_s: float, begin_s: float = 0.0) -> Stick:
    """Return the stick of a recorded flight; a missing value is 0.

    The first row is assumed to hold before the log too.
    """
    stamps_s = np.concatenate([command.stamps_s[:1] - UNLOGGED_S, command.stamps_s[1:]])
    return Stick(stamps_s, np.nan_to_num(command.stick), duration_s, begin_s)


def _centred(values: Array) -> Array:
    return np.asarray(((values[:, 0] == 0) & (values[:, 1] == 0)).astype(float))
