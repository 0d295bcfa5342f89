"""Rounded readings: the values of a channel are multiples of a step that is coarse beside its noise, in the
whole flight or in a part of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from slam.core.arrays import Array
from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.finding import Finding

EXACT = 0.02
"""Greatest distance from a multiple of the step, as a share of it."""
FEWEST_VALUES = 4
FITTING = 0.98
"""Least share of the readings that are multiples."""
PARTS, LEAST_SHARE = 20, 0.1
"""Number of parts of a flight that are looked at one by one, and least share of it that is rounded, and of
what is not."""
FEWEST_OF_PART = 10
"""Least number of readings of a part."""


@dataclass(frozen=True)
class Rounding(Finding):
    """The step of a channel."""

    step: float
    unit: str
    begin_s: float | None = None
    """Begin of the rounding; None where it lasts for the whole flight."""
    lasts_s: float | None = None
    """Its duration; None likewise."""

    @property
    def is_shown_otherwise(self) -> bool:
        """Whether it is the quantisation of a sonar, which is a cause."""
        return self.channel == "range" and self.begin_s is None

    def _text(self) -> str:
        degrees = f" ({np.degrees(self.step):.2g} deg)" if self.unit == "rad" else ""
        when = ""
        if self.begin_s is not None:
            when = f" from {self.begin_s:.0f} s on, for {self.lasts_s:.0f} s"
        return f"{self.channel} is rounded to steps of {self.step:.3g} {self.unit}{degrees}{when}"


def rounding(stream: InstrumentReadings) -> Rounding | None:
    """Return the coarsest rounding of the stream's channels beyond its stated noise, or None.

    Rounding to a step q adds a standard deviation of q / sqrt(12) (Widrow, 1956).
    """
    found = []
    for name, column, noise in zip(stream.channels, stream.values.T, stream.noise_std, strict=True):
        finite = np.isfinite(column)
        alone = replace(stream, channels=(name,), stamps_s=stream.stamps_s[finite])
        found.append(_of_all(alone, column[finite], noise) or _of_part(alone, column[finite], noise))
    return max(filter(None, found), key=lambda r: r.step, default=None)


def _of_all(stream: InstrumentReadings, readings: Array, noise: float) -> Rounding | None:
    step = _step(readings, np.sqrt(12.0) * noise)
    return Rounding(step, stream.unit, channel=stream.channels[0]) if step else None


def _of_part(stream: InstrumentReadings, readings: Array, noise: float) -> Rounding | None:
    """Return the longest rounding to one step in a part of the flight, or None.

    The noise of an instrument that begins to round has changed: its step need only exceed that.
    """
    edges = np.linspace(0, len(readings), PARTS + 1).astype(np.int64)
    if len(readings) < PARTS * FEWEST_OF_PART:
        return None
    steps = [_step(readings[begin:end], noise) for begin, end in pairwise(edges.tolist())]
    longest = 0, 0, 0.0
    for k in np.flatnonzero(steps).tolist():
        step = steps[k]
        whole = (readings - readings[edges[k]]) / step
        off = np.flatnonzero(np.abs(whole - np.rint(whole)) > EXACT)
        # All readings about the part up to the nearest ones that are no multiples.
        after = int(np.searchsorted(off, edges[k]))
        begin = int(off[after - 1]) + 1 if after else 0
        end = int(off[after]) if after < len(off) else len(readings)
        longest = max(longest, (end - begin, begin, step))
    count, begin, step = longest
    others = np.delete(readings, np.s_[begin : begin + count])
    if min(count, len(others)) < LEAST_SHARE * len(readings) or _step(others, noise):
        return None
    times_s = stream.stamps_s[begin : begin + count]
    return Rounding(step, stream.unit, float(times_s[0]), float(np.ptp(times_s)), channel=stream.channels[0])


def _step(readings: Array, least: float) -> float:
    """Return the step that readings (n,) are rounded to, if it is greater than ``least``; 0 for none."""
    values = np.unique(readings)
    if len(values) < FEWEST_VALUES:
        return 0.0
    gaps = np.diff(values)
    step = float(np.median(gaps[gaps <= 1.5 * gaps.min()]))
    apart = np.abs(gaps / step - np.rint(gaps / step)) if step > 0.0 else np.ones(1)
    return step if np.mean(apart < EXACT) > FITTING and step > least else 0.0
