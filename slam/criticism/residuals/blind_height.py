"""Residuals of a sonar's heights against heights predicted without the sonar."""

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
"""Nearer to the floor the gear and the sonar's own limit cause edges."""
LONGEST_GAP_S, LONGEST_GAP = 0.2, 2.5
"""Longest gap within a segment, in seconds and in median intervals."""
APART = 10
"""Distance in readings of the differences from which the effects of the motion are fitted."""
FEWEST_READINGS = 20
REJECTED, ROUNDS = 4.7, 5
"""Rejection limit in robust standard deviations (Tukey's biweight), and rounds of the fit."""
TINY = 1e-12


@dataclass(frozen=True)
class RangeResiduals:
    """Residuals of one flight's sonar against a height predicted without it."""

    rows: Ints
    """(readings,) events of readings in the air."""
    times_s: Array
    begins: tuple[int, ...]
    """Indices at which segments without a gap begin."""
    off_m: Array
    """(readings,) measured minus predicted height, in metres."""
    motion: Array
    """(readings, signals) regressors for the errors of instruments and vehicle."""
    upright: Array
    """(readings,) ratio of height to range."""

    @property
    def segments(self) -> list[slice]:
        """Segments with at least ``FEWEST_READINGS`` readings."""
        ends = (*self.begins[1:], len(self.rows))
        every = (slice(begin, end) for begin, end in zip(self.begins, ends, strict=False))
        return [s for s in every if s.stop - s.start >= FEWEST_READINGS]

    def without_motion(self, over_m: Array) -> Array:
        """Return (readings,) ``off_m`` without the effects of the motion; ``over_m`` is a known part."""
        later = [self._later(x, APART) for x in (self.motion, self.off_m - over_m)]
        return np.asarray(self.off_m - self.motion @ _robust_fit(*later))

    def jumps_m(self, height_m: Array) -> Array:
        """Return the changes of (readings,) from one reading to the next within a segment."""
        return self._later(height_m, 1)

    def _later(self, x: Array, count: int) -> Array:
        """Return the changes over ``count`` readings within segments."""
        changes = [x[s][count:] - x[s][:-count] for s in self.segments]
        return np.concatenate([np.zeros((0, *x.shape[1:])), *changes])


def range_residuals(record: Record, parameters: FilterParameters) -> RangeResiduals:
    """Return the residuals of the flight's sonar against a filter without sonar readings."""
    sonar = record.kinds == SONAR
    rows = np.flatnonzero(sonar & np.isfinite(record.values[:, 0]) & (record.values[:, 0] > LOWEST_M))
    blind = record.values.copy()
    blind[sonar] = np.nan
    states = whole(replace(record, values=blind), parameters).states[rows]
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
    return RangeResiduals(rows, times_s, begins, off_m, motion, upright)


def _robust_fit(table: Array, values: Array) -> Array:
    """Return the coefficients of the columns by robust, iterated least squares."""
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
