"""A figure of a benchmark, and its target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Direction = Literal["at most", "at least", "within", "reported"]


class Skipped(Exception):
    """The benchmark cannot run here; the message says what is missing."""


@dataclass(frozen=True)
class Metric:
    """One figure with unit, direction and limit; ``reported`` ones have no limit."""

    key: str
    value: float
    unit: str
    direction: Direction = "reported"
    limit: tuple[float, ...] = ()
    """One limit, or the two ends of a band."""
    source: str = ""
    """Method of measurement, where the key does not give it."""

    @property
    def met(self) -> bool | None:
        """Whether the limit is met; None without a limit. A figure that is not finite meets no limit."""
        if self.direction == "reported":
            return None
        if not math.isfinite(self.value):
            return False
        if self.direction == "within":
            return self.limit[0] <= self.value <= self.limit[1]
        return self.value <= self.limit[0] if self.direction == "at most" else self.value >= self.limit[0]

    def __str__(self) -> str:
        """Return key, value, unit and method."""
        return f"{self.key}: {self.value:.3g} {self.unit}; {self.source}"


def at_most(key: str, value: float, unit: str, limit: float, source: str = "") -> Metric:
    """Return a figure that must not exceed its limit."""
    return Metric(key, float(value), unit, "at most", (limit,), source)


def at_least(key: str, value: float, unit: str, limit: float, source: str = "") -> Metric:
    """Return a figure that must reach its limit."""
    return Metric(key, float(value), unit, "at least", (limit,), source)


def within(key: str, value: float, unit: str, band: tuple[float, float], source: str = "") -> Metric:
    """Return a figure that must lie in its band."""
    return Metric(key, float(value), unit, "within", band, source)


def reported(key: str, value: float, unit: str, source: str = "") -> Metric:
    """Return a figure without a limit."""
    return Metric(key, float(value), unit, source=source)


def rms_length(off: NDArray[np.float64]) -> float:
    """Return the root mean square length of (n, d) differences."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
