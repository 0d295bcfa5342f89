"""Lag of a stream's readings: a delay, a low-pass filter of the first order, and the finding of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from slam.core.recursion import recursion
from slam.data_quality.finding import Finding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lag:
    """Time by which readings lag behind the motion."""

    delay_s: float = 0.0
    smoothing_s: float = 0.0
    """Time constant of the low-pass filter."""

    def of(self, stamps_s: Array, signal: Array) -> Array:
        """Return the lagged signal (n, k) at its own stamps (n,)."""
        if self == PROMPT:
            return signal
        lagged = signal
        if self.smoothing_s > 0.0:
            lagged = _smoothed(stamps_s, signal, self.smoothing_s)
        if self.delay_s == 0.0:
            return lagged
        return np.column_stack([np.interp(stamps_s - self.delay_s, stamps_s, column) for column in lagged.T])


PROMPT = Lag()
"""Readings of the motion at their stamps."""


def _smoothed(stamps_s: Array, signal: Array, time_s: float) -> Array:
    """Return the signal behind the filter, which begins at rest; it is sampled at even times meanwhile."""
    even_s = np.linspace(stamps_s[0], stamps_s[-1], len(stamps_s))
    share = -np.expm1(-(even_s[1] - even_s[0]) / time_s)
    # The mean of both ends of a step is held over it: a held first value would be half a step late.
    even = np.column_stack([np.interp(even_s, stamps_s, column) for column in signal.T]) - signal[0]
    even[1:] = 0.5 * (even[1:] + even[:-1])
    followed = recursion(share * even, 1.0 - share) + signal[0]
    return np.column_stack([np.interp(stamps_s, even_s, column) for column in followed.T])


@dataclass(frozen=True)
class LateReadings(Finding):
    """Readings of a stream (``channel``) that come late, or early, by their stamps, or behind a filter."""

    BY_DELAY: ClassVar[str] = "late"
    BY_FILTER: ClassVar[str] = "smoothed"

    late_s: float
    """The mean age of a reading, or its standard deviation: of a low-pass filter, the time constant."""
    lag: str = BY_DELAY

    def _text(self) -> str:
        if self.lag == self.BY_FILTER:
            return f"{self.channel} smoothed over {1e3 * self.late_s:.1f} ms"
        return f"{self.channel} {'late' if self.late_s > 0.0 else 'early'} by {1e3 * abs(self.late_s):.1f} ms"
