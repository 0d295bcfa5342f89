"""Rounded readings: all values of a channel are multiples of a step that is coarse beside its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.data_quality.channels import InstrumentReadings
from slam.data_quality.finding import Finding

EXACT = 0.02
"""Greatest distance from a multiple of the step, as a share of it."""
FEWEST_VALUES = 4
FITTING = 0.98
"""Least share of the readings that are multiples."""


@dataclass(frozen=True)
class Rounding(Finding):
    """The step of a channel."""

    step: float
    unit: str

    @property
    def is_shown_otherwise(self) -> bool:
        """Whether it is the quantisation of a sonar, which is a cause."""
        return self.channel == "range"

    def _text(self) -> str:
        degrees = f" ({np.degrees(self.step):.2g} deg)" if self.unit == "rad" else ""
        return f"{self.channel} is rounded to steps of {self.step:.3g} {self.unit}{degrees}"


def rounding(stream: InstrumentReadings) -> Rounding | None:
    """Return the coarsest rounding of the stream's channels beyond its stated noise, or None.

    Rounding to a step q adds a standard deviation of q / sqrt(12) (Widrow, 1956).
    """
    found = []
    for name, column, noise in zip(stream.channels, stream.values.T, stream.noise_std, strict=True):
        values = np.unique(column[np.isfinite(column)])
        if len(values) < FEWEST_VALUES:
            continue
        gaps = np.diff(values)
        step = float(np.median(gaps[gaps <= 1.5 * gaps.min()])) if len(gaps) else 0.0
        apart = np.abs(gaps / step - np.rint(gaps / step)) if step > 0.0 else np.ones(1)
        if np.mean(apart < EXACT) > FITTING and step / np.sqrt(12.0) > noise:
            found.append(Rounding(step, stream.unit, channel=name))
    return max(found, key=lambda r: r.step, default=None)
