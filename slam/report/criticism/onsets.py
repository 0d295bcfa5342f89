"""Sizes before and after the moment at which the size of an effect changes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.criticism.cause import Interval
from slam.report.criticism.plain_names import TWO_SIDED
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.verdict.over_time import SizeOverTime

ONSET = rf"^({'|'.join(CATALOGUE)})\.(\w+) changes by (\S+).* at about ([\d.]+) s \(z = ([-\d.]+)\)$"
"""A change as verdict.json describes it: effect, parameter, difference, time and standard deviations."""
_WHOLE_SECONDS = 0.5
"""Greatest difference of a time from what is told in whole seconds."""


@dataclass(frozen=True)
class SizeChange:
    """Sizes of one parameter on either side of a moment."""

    time_s: float
    z: str
    before: Interval
    after: Interval

    @property
    def moment(self) -> str:
        """The moment in words."""
        return f"about {self.time_s:.0f} s"


def change_of_size(result: Criticism, effect: str, parameter: str) -> SizeChange | None:
    """Return the moment at which a size changes for certain, with the sizes before and after it; None where
    there is no such moment, or more flights than one."""
    column = f"{effect}.{parameter}"
    matches = (re.match(ONSET, part) for part in result.unexplained)
    found = next((m for m in matches if m and f"{m[1]}.{m[2]}" == column), None)
    series = next((s for s in result.changes if s.column == column), None)
    if found is None or series is None or len(set(series.flights)) > 1:
        return None
    after = series.begin_s >= float(found[4]) - _WHOLE_SECONDS
    if after.all() or not after.any():
        return None
    return SizeChange(float(found[4]), found[5], _mean(series, ~after), _mean(series, after))


def _mean(series: SizeOverTime, rows: NDArray[np.bool_]) -> Interval:
    """Return the weighted mean size of some parts; parts that differ by more than their errors widen it."""
    sizes, weight = series.sizes[rows], series.errors[rows] ** -2.0
    mean = float(np.average(sizes, weights=weight))
    spread = float(weight @ (sizes - mean) ** 2) / max(len(sizes) - 1, 1)
    reach = TWO_SIDED * float(np.sqrt(max(spread, 1.0) / weight.sum()))
    return Interval(mean, series.unit, mean - reach, mean + reach)
