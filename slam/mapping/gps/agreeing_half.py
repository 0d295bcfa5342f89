"""Half of the GPS fixes that agree with the pictures while the others contradict them.

More than half must agree for the least median of squares (`slam.mapping.gps.consensus`). Where tags are wrong
by the same step, such as those after a restart of the receiver, exactly half may agree. A map on both halves
has a wrong scale or heading, and one on either half has the right ones. Source: Rousseeuw and Van Driessen
2006 (Computing LTS regression for large data sets), for the concentration steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.bundle.problem import LARGEST_SLOPE_RAD
from backend.quantiles import f_limit
from slam.mapping.gps.pairs import some_pairs

Complex = NDArray[np.complex128]

LEAST_FOR_HALF = 7
"""Three of six agree by chance: two of them always fit a similarity."""
_FALSE_ALARM = 1e-5
"""Probability of the limit for one half. The best of all halves exceeds the limit in less than 0.1 % of the
sets of fixes with Gaussian noise, with 7 to 75 fixes in a line or in lanes (1000 drawn sets each)."""
_MOST_LEAN = 2 * LARGEST_SLOPE_RAD
"""Displacement in heights between two opposite directions of flight, by a camera that leans as far as the
ground may slope. Lanes flown there and back are then halves that contradict each other."""
_STARTS, _STEPS = 300, 6


class SimilarityFit(NamedTuple):
    """Similarity ``b = turn a + shift`` of the plane, as complex numbers."""

    turn: complex
    """Rotation and scale."""
    shift: complex
    limit_m: float
    """Distance beyond which a fix is an outlier."""


def agreeing_half(
    a: Complex, b: Complex, metric: bool, least_m: float, height: float, rng: np.random.Generator
) -> SimilarityFit | None:
    """Return the similarity of half of the fixes.

    ``a`` (n,) are places on the map, ``b`` (n,) those of the fixes in metres. None unless all other fixes are
    out of the noise of this half, farther than ``least_m``, and farther than a leaning mount displaces a
    camera at ``height`` on the map.
    """
    n, half = len(a), (len(a) + 1) // 2
    if n < LEAST_FOR_HALF:
        return None
    i, j = some_pairs(n, _STARTS, rng)
    i, j = i[a[i] != a[j]], j[a[i] != a[j]]
    inside = np.column_stack([i, j])
    for _ in range(_STEPS):
        turn, shift = _fitted(a[inside], b[inside], metric)
        distance = np.abs(b - turn * a - shift)
        inside = np.argpartition(distance, half - 1, axis=1)[:, :half]
    squares = np.sum(np.partition(distance, half - 1, axis=1)[:, :half] ** 2, axis=1)
    squares[(np.abs(turn[:, 0]) < 1e-9) | ~np.isfinite(squares)] = np.inf
    if not np.isfinite(squares).any():
        return None
    best = int(np.argmin(squares))
    left = 2 * half - (3 if metric else 4)
    noise_m = float(np.sqrt(squares[best] / left * 2 * f_limit(_FALSE_ALARM, 2, left)))
    limit_m = max(noise_m, least_m, _MOST_LEAN * float(np.abs(turn[best, 0])) * height)
    if np.partition(distance[best], half)[half] <= limit_m:
        return None
    return SimilarityFit(complex(turn[best, 0]), complex(shift[best, 0]), limit_m)


def _fitted(a: Complex, b: Complex, metric: bool) -> tuple[Complex, Complex]:
    """Return turns and shifts (s, 1) of the least squares for subsets (s, k) of the fixes."""
    a0, b0 = a.mean(axis=1, keepdims=True), b.mean(axis=1, keepdims=True)
    spread = np.sum(np.abs(a - a0) ** 2, axis=1, keepdims=True)
    turn = np.sum(np.conj(a - a0) * (b - b0), axis=1, keepdims=True) / np.where(spread > 0, spread, 1.0)
    if metric:
        size = np.abs(turn)
        turn = np.where(size > 0, turn / np.where(size > 0, size, 1.0), 0.0)
    return turn, b0 - turn * a0
