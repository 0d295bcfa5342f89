"""Silent instruments: a stream without readings for a while, or from a moment on, while the others go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam.core.arrays import Array, Mask
from slam.core.streams import Sonar
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.finding import Finding

LONGEST_S = 5.0
"""Longest healthy gap: what lasts longer ends a record of the filter, too."""
NEAR_LIMIT = 0.8
"""Share of the greatest range from which a sonar may lose its echo; the reciprocal for the least range."""


@dataclass(frozen=True)
class Silent(Finding):
    """The longest gap of a stream (``channel``)."""

    begin_s: float
    lasts_s: float
    is_last: bool
    """Whether no reading follows."""

    def _text(self) -> str:
        how = "to the end" if self.is_last else f"for {self.lasts_s:.2g} s"
        return f"the {self.channel} has no readings from {self.begin_s:.0f} s {how}, and the others go on"


def silent(
    stream: InstrumentReadings, end_s: float, moves: Callable[[float, float], bool], sonar: Sonar | None
) -> Silent | None:
    """Return the longest gap of a stream between its first reading and ``end_s``, or None.

    ``moves`` says whether other instruments show a flight between two times. A ``sonar`` near a limit of its
    range may have no echo.
    """
    finite = np.isfinite(stream.values).all(axis=1)
    known_s = stream.stamps_s[finite]
    if len(known_s) == 0:
        return None
    ends_s = np.append(known_s, max(end_s, known_s[-1]))
    lasts_s = np.diff(ends_s)
    if stream.name == "sonar" and sonar is not None:
        lasts_s[_near_limit(stream.values[finite, 0], sonar)] = 0.0
    for k in np.argsort(-lasts_s).tolist():
        if lasts_s[k] < LONGEST_S:
            break
        if moves(float(ends_s[k]), float(ends_s[k + 1])):
            last = k == len(lasts_s) - 1
            return Silent(float(ends_s[k]), float(lasts_s[k]), last, channel=stream.name)
    return None


def _near_limit(range_m: Array, sonar: Sonar) -> Mask:
    """Return which gaps after each of some ranges (n,) begin or end near a limit.

    Where no greatest range is stated, the greatest reading may be the limit. It is none if most readings are
    near it, as in level flight: what is read most of the time is within reach.
    """
    is_stated = bool(np.isfinite(sonar.max_range_m))
    far = range_m > NEAR_LIMIT * (sonar.max_range_m if is_stated else float(range_m.max()))
    if not is_stated and np.mean(far) > 0.5:
        far[:] = False
    near = far | (range_m < sonar.min_range_m / NEAR_LIMIT)
    return np.asarray(near | np.append(near[1:], False))
