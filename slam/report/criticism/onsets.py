"""Sizes before and after the moment at which the size of an effect changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.criticism.cause import Interval
from slam.criticism.finding import Onset
from slam.report.criticism.plain_names import TWO_SIDED

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.verdict.over_time import SizeOverTime


@dataclass(frozen=True)
class SizeChange:
    """Sizes of one parameter on either side of a moment."""

    time_s: float
    z: float
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
    onsets = (finding for finding in result.findings if isinstance(finding, Onset))
    found = next((onset for onset in onsets if onset.column == column), None)
    series = next((s for s in result.changes if s.column == column), None)
    if found is None or series is None or len(set(series.flights)) > 1:
        return None
    after = series.begin_s >= found.time_s
    if after.all() or not after.any():
        return None
    return SizeChange(found.time_s, found.z, _mean(series, ~after), _mean(series, after))


def _mean(series: SizeOverTime, rows: NDArray[np.bool_]) -> Interval:
    """Return the weighted mean size of some parts; parts that differ by more than their errors widen it."""
    sizes, weight = series.sizes[rows], series.errors[rows] ** -2.0
    mean = float(np.average(sizes, weights=weight))
    spread = float(weight @ (sizes - mean) ** 2) / max(len(sizes) - 1, 1)
    reach = TWO_SIDED * float(np.sqrt(max(spread, 1.0) / weight.sum()))
    return Interval(mean, series.unit, mean - reach, mean + reach)
