"""Quantisation of a sonar: its readings are whole multiples of a step, up to the last digit written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEPS_M = np.arange(0.002, 0.0601, 0.0001)
STEP_STD_M = 1e-4
MOST_READINGS = 5000
"""Number of readings that suffice."""
LEAST_NATS = 20.0
"""Least n |mean exp(2 pi i r / step)|^2 of quantised readings; a smooth distribution has about 1."""


@dataclass(frozen=True)
class Quantisation:
    """Readings are multiples of a step."""

    step_m: float
    strength: float
    """1 if all of them are."""
    nats: float
    """Evidence in the readings."""

    def nats_of(self, ranges_m: Array) -> float:
        """Return the evidence of other ranges (n,) for the same step."""
        return len(ranges_m) * float(np.abs(_phase_mean(ranges_m, self.step_m))) ** 2


def quantisation_of(ranges_m: Array, noise_m: float) -> Quantisation | None:
    """Return the quantisation of ranges (n,), or None; ``noise_m`` is the stated noise of one of them."""
    found = strongest_step(ranges_m)
    if found is None:
        return None
    # Readings with little spread look like a coarse quantisation.
    smooth = np.exp(-2.0 * (np.pi * 0.8 * noise_m / found.step_m) ** 2)
    return found if found.nats >= LEAST_NATS and found.strength >= 0.5 + 0.5 * smooth else None


def _phase_mean(ranges: Array, step_m: float | Array) -> Array:
    """Return the mean of exp(2 pi i r / step) for each step."""
    return np.asarray(np.exp(2j * np.pi * ranges / np.asarray(step_m)[..., None]).mean(axis=-1))


def strongest_step(ranges: Array) -> Quantisation | None:
    """Return the step whose multiples fit the ranges best; None for few ranges or equal ones."""
    if len(ranges) < 50 or np.ptp(ranges) < 0.02:
        return None
    ranges = ranges[:: 1 + len(ranges) // MOST_READINGS]
    strength = np.abs(_phase_mean(ranges, STEPS_M))
    # All divisors of the step fit as well; the step is the longest.
    best = int(np.flatnonzero(strength > 0.9 * strength.max())[-1])
    while best > 0 and strength[best - 1] > strength[best]:
        best -= 1
    return Quantisation(float(STEPS_M[best]), float(strength[best]), float(len(ranges) * strength[best] ** 2))
