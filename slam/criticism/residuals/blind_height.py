"""What a sonar reads beside a height that is predicted without it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.criticism.kalman.filter_parameters import FilterParameters
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import SONAR
from slam.criticism.kalman.record import Record
from slam.simulation.dynamics import PITCH, ROLL, UP, VX, VY, VZ, X, Y, Z

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LOWEST_M = 0.3
"""Nearer to the floor the gear and the sonar's own limit make edges."""
LONGEST_GAP_S, LONGEST_GAP = 0.2, 2.5
"""Between readings of one stretch, in seconds, or in times of what lies between most."""
APART = 10
"""Readings apart whose differences tell what goes with the motion."""
FEWEST_READINGS = 20
REJECTED, ROUNDS = 4.7, 5
"""Of a robust standard deviation (Tukey's biweight)."""
TINY = 1e-12


@dataclass(frozen=True)
class Beside:
    """Of one flight: what its sonar reads beside a height predicted without it."""

    rows: Ints
    """(readings,) events, in the air."""
    times_s: Array
    begins: tuple[int, ...]
    """Where stretches without a gap begin among them."""
    off_m: Array
    """(readings,) height read less height predicted."""
    motion: Array
    """(readings, signals) what errors of instruments and vehicle go with."""
    upright: Array
    """(readings,) height over range."""

    @property
    def stretches(self) -> list[slice]:
        """Those that are long enough."""
        ends = (*self.begins[1:], len(self.rows))
        every = (slice(begin, end) for begin, end in zip(self.begins, ends, strict=False))
        return [s for s in every if s.stop - s.start >= FEWEST_READINGS]

    def without_motion(self, over_m: Array) -> Array:
        """(readings,) ``off_m`` without what goes with the motion; ``over_m`` is known of it."""
        later = [self._later(x, APART) for x in (self.motion, self.off_m - over_m)]
        return np.asarray(self.off_m - self.motion @ _robust_fit(*later))

    def jumps_m(self, height_m: Array) -> Array:
        """From one reading to the next within a stretch, of (readings,)."""
        return self._later(height_m, 1)

    def _later(self, x: Array, count: int) -> Array:
        """Changes over so many readings, within stretches."""
        changes = [x[s][count:] - x[s][:-count] for s in self.stretches]
        return np.concatenate([np.zeros((0, *x.shape[1:])), *changes])


def beside(record: Record, setting: FilterParameters) -> Beside:
    """What the flight's sonar reads beside a filter that does not hear it."""
    sonar = record.kinds == SONAR
    rows = np.flatnonzero(sonar & np.isfinite(record.values[:, 0]) & (record.values[:, 0] > LOWEST_M))
    blind = record.values.copy()
    blind[sonar] = np.nan
    states = whole(replace(record, values=blind), setting).states[rows]
    times_s = record.times_s[rows]
    upright = np.cos(states[:, ROLL]) * np.cos(states[:, PITCH])
    between_s = np.diff(times_s)
    longest_s = max(LONGEST_GAP_S, LONGEST_GAP * float(np.median(between_s))) if len(between_s) else 0.0
    begins = (0, *(np.flatnonzero(between_s > longest_s) + 1).tolist()) if len(rows) else ()
    elapsed = times_s / record.duration_s
    motion = np.column_stack(
        [
            states[:, [Z, VZ, ROLL, PITCH, X, Y]], record.stick.at(times_s)[:, UP], elapsed, elapsed**2,
            states[:, ROLL] ** 2 + states[:, PITCH] ** 2, np.hypot(states[:, VX], states[:, VY]),
        ]
    )  # fmt: skip
    off_m = record.values[rows, 0] * upright - states[:, Z]
    return Beside(rows, times_s, begins, off_m, motion, upright)


def _robust_fit(table: Array, values: Array) -> Array:
    """Coefficients of the columns, whatever a part of the values is (iterated least squares)."""
    found, weight = np.zeros(table.shape[1]), np.ones(len(values))
    if len(values) < 2 * table.shape[1]:
        return found
    scale = np.sqrt(np.mean(table**2, axis=0)) + TINY
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(table / scale * root[:, None], values * root, rcond=1e-9)[0] / scale
        miss = values - table @ found
        weight = np.clip(1.0 - (miss / (REJECTED * robust_std(miss) + TINY)) ** 2, 0.0, None) ** 2
    return found
