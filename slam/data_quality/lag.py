"""Lag of a stream's readings behind the motion: a delay, and a low-pass filter of the first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.core.recursion import recursion

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
