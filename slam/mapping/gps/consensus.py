"""Which GPS fixes agree with the pictures: up to 30 % may be gross outliers, any of them.

Before refinement the map's scale and heading are unknown and its shape is bent, so that fixes are compared up
to a similarity of the plane, with a wide limit. Source: Rousseeuw and Leroy 1987, chapters 3 and 5 (least
median of squares). Where no majority agrees, half of the fixes may (`slam.mapping.gps.agreeing_half`).
After refinement the map stands where the fixes have put it, and the limit is that of the fixes' own noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from backend.bundle.noise_level import over_typical
from backend.bundle.problem import LARGEST_SLOPE_RAD
from backend.quantiles import f_limit
from slam.mapping.gps.agreeing_half import SimilarityFit, agreeing_half
from slam.mapping.gps.pairs import some_pairs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BENT_MAP = 20.0
"""Limit of the first comparison in robust standard deviations. A map that is bent as a parabola fits a line
over half of its fixes with a median error of 1/17 of that at its far end, which is 20 of these deviations."""
FALSE_ALARM = 0.01
"""Probability that a set of fixes, or of control points, with Gaussian noise loses one of them in the second
comparison."""
STATED_SIGMAS = 3.0
"""No fix is an outlier that is so close to the map in the nominal standard deviations."""
LEAST_FIXES = 4
"""With three fixes any one of them may be the wrong one: two always fit a similarity."""
_PAIRS = 1000
MEDIAN_OF_RAYLEIGH, _MEDIAN_OF_NORMAL = 1.1774, 0.6745
_FITTED = {2: 4, 1: 1}
"""Numbers that fixes determine of a map: a similarity of the plane, and a height."""


@dataclass(frozen=True)
class Agreement:
    """Verdict of the map on each fix."""

    used: Mask
    """(n,) whether the fix is used. Fixes that the map does not cover are."""
    altitude_used: Mask
    """(n,) the same for its altitude."""
    off_m: Array
    """(n, 3) the fix minus the map, in metres of the fixes; NaN where the map does not cover it."""

    def same(self, other: Agreement) -> bool:
        """Return whether both use the same fixes."""
        used = np.array_equal(self.used, other.used)
        return used and np.array_equal(self.altitude_used, other.altitude_used)

    def without(self, fixes: Mask) -> Agreement:
        """Return the verdict with some more ``fixes`` (n,) left out."""
        return replace(self, used=self.used & ~fixes, altitude_used=self.altitude_used & ~fixes)

    @property
    def count(self) -> int:
        """Number of fixes that the map covers."""
        return int(np.isfinite(self.off_m[:, 0]).sum())

    @property
    def agreeing(self) -> int:
        """Number of them that are used."""
        return int((self.used & np.isfinite(self.off_m[:, 0])).sum())


def rough_agreement(
    here_m: Array,
    there_m: Array,
    metric: bool,
    nominal_std_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Agreement:
    """Compare the fixes ``there_m`` (n, 3) with a level, unplaced map ``here_m`` (n, 3) up to a similarity.

    ``metric``: whether the map's lengths are metres already. NaN marks what the map does not cover.
    """
    n = len(here_m)
    everything = Agreement(np.ones(n, bool), np.ones(n, bool), np.full((n, 3), np.nan))
    known, a, b = _level_places(here_m, there_m)
    if len(known) < LEAST_FIXES:
        return everything
    rng, height = np.random.default_rng(0), float(np.nanmedian(here_m[known, 2]))
    # Where a majority agrees, there is no half: the next fix lies as near as those of the half.
    fit = agreeing_half(a, b, metric, nominal_limit_m(nominal_std_m), height, rng)
    fit = fit or _majority(a, b, metric, rng)
    if fit is None:
        return everything
    horizontal = b - fit.turn * a - fit.shift
    good = np.abs(horizontal) <= fit.limit_m
    off = everything.off_m.copy()
    off[known, 0], off[known, 1] = horizontal.real, horizontal.imag
    rise = there_m[known, 2] - abs(fit.turn) * here_m[known, 2]
    used = everything.used.copy()
    used[known[~good]] = False
    altitude_used = used.copy()
    scored = np.flatnonzero(good & np.isfinite(rise))
    if len(scored):
        level, std = _shortest_half(rise[scored])
        off[known, 2] = rise - level
        middle = complex(np.median(b[good].real), np.median(b[good].imag))
        reach = LARGEST_SLOPE_RAD * np.abs(b - middle)  # of the ground, or of the unrefined map
        altitude_used[known[~(np.abs(rise - level) <= BENT_MAP * std + reach) & np.isfinite(rise)]] = False
    return Agreement(used, altitude_used, off)


def _majority(
    a: NDArray[np.complex128], b: NDArray[np.complex128], metric: bool, rng: np.random.Generator
) -> SimilarityFit | None:
    """Return the least median of squares; outliers are beyond its limit."""
    fit = _least_median(a, b, metric, rng)
    if fit is None:
        return None
    turn, shift = fit
    median_m = float(_upper_median(np.abs(b - turn * a - shift)))
    return SimilarityFit(turn, shift, BENT_MAP * _small_sample(len(a), 2) * median_m / MEDIAN_OF_RAYLEIGH)


def _level_places(
    here_m: Array, there_m: Array
) -> tuple[NDArray[np.int64], NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the rows (k,) with both places known, and x + iy of both places there, each (k,)."""
    known = np.flatnonzero(np.isfinite(here_m[:, :2]).all(axis=1) & np.isfinite(there_m[:, :2]).all(axis=1))
    a, b = (places_m[known, 0] + 1j * places_m[known, 1] for places_m in (here_m, there_m))
    return known, a, b


def rough_turn(here_m: Array, there_m: Array, metric: bool) -> complex | None:
    """Return rotation and scale of the similarity that takes level places ``here_m`` (n, 3) to the fixes
    ``there_m`` (n, 3), the least median of squares; None for fewer than two, or without any extent."""
    known, a, b = _level_places(here_m, there_m)
    if len(known) < 2:
        return None
    fit = _majority(a, b, metric, np.random.default_rng(0))
    return None if fit is None else fit.turn


def nominal_limit_m(nominal_std_m: tuple[float, float, float]) -> float:
    """Return the horizontal distance up to which a fix may lie from the map by its nominal deviations."""
    return STATED_SIGMAS * float(np.hypot(*nominal_std_m[:2]) / np.sqrt(2))


def exact_agreement(
    off_m: Array, nominal_std_m: Array | tuple[float, float, float], map_std_m: Array | None = None
) -> Agreement:
    """Compare fixes with a refined map that stands where they have put it.

    ``off_m`` (n, 3) is fix minus map, NaN where either is missing. The nominal deviations are those of all
    fixes (3,), or of each (n, 3). ``map_std_m`` (n, 3) are standard deviations of the map at fixes that it
    does not use, and 0 at the others. A fix that is not used is not called back where the map's deviation is
    unknown (NaN).
    """
    n = len(off_m)
    used, altitude_used = np.ones(n, bool), np.ones(n, bool)
    nominal = np.broadcast_to(nominal_std_m, (n, 3))
    across, up = over_typical(np.hypot(nominal[:, 0], nominal[:, 1])), over_typical(nominal[:, 2])
    std_m = np.hypot(nominal, np.zeros((n, 3)) if map_std_m is None else map_std_m)
    least_m = STATED_SIGMAS * np.hypot(std_m[:, 0], std_m[:, 1]) / np.sqrt(2)
    known = np.flatnonzero(np.isfinite(off_m[:, :2]).all(axis=1))
    if len(known) < LEAST_FIXES:
        return Agreement(used, altitude_used, off_m)
    distance_m = np.linalg.norm(off_m[known, :2], axis=1)
    used[known] = _within(distance_m / across[known], 2, least_m[known] / across[known])
    altitude_used &= used
    high = np.flatnonzero(np.isfinite(off_m[:, 2]) & used)
    if len(high) >= LEAST_FIXES:
        least_m = STATED_SIGMAS * std_m[high, 2]
        altitude_used[high] &= _within(np.abs(off_m[high, 2]) / up[high], 1, least_m / up[high])
    return Agreement(used, altitude_used, off_m)


def _within(distance: Array, dimensions: int, least: Array) -> Mask:
    """Return which distances (n,) in 1 or 2 dimensions are Gaussian noise, those of a map that follows them.

    None below ``least`` (n,) is an outlier. The standard deviation starts from the median and is then that of
    the accepted distances, without bias if no outlier is among them.
    """

    def freedom(used: Mask) -> int:
        return max(dimensions * int(used.sum()) - _FITTED[dimensions], 1)

    n = len(distance)
    median = MEDIAN_OF_RAYLEIGH if dimensions == 2 else _MEDIAN_OF_NORMAL
    # Half of the fixes, not one more: the other half may have their altitudes from another reference.
    half = float(np.partition(distance, (n - 1) // 2)[(n - 1) // 2])
    std = _small_sample(n, dimensions) * half / median
    good = np.ones(n, bool)
    for _ in range(20):
        # Fixes are compared with a deviation that they themselves give: F instead of chi-square.
        limit = std * np.sqrt(dimensions * f_limit(FALSE_ALARM / n, dimensions, freedom(good)))
        now = distance <= np.maximum(limit, least)
        if np.array_equal(now, good) or now.sum() < LEAST_FIXES:
            break
        good = now
        std = float(np.sqrt(np.sum(distance[good] ** 2) / freedom(good)))
    return good


def _least_median(
    a: NDArray[np.complex128], b: NDArray[np.complex128], metric: bool, rng: np.random.Generator
) -> tuple[complex, complex] | None:
    """Return (turn, shift) of ``b = turn a + shift`` with the least median error, over pairs of points."""
    n = len(a)
    i, j = some_pairs(n, _PAIRS, rng)
    apart = np.abs(a[j] - a[i])
    i, j = i[apart >= np.median(apart)], j[apart >= np.median(apart)]  # short ones give a poor heading
    step = a[j] - a[i]
    turn = np.where(step == 0, 0, (b[j] - b[i]) / np.where(step == 0, 1, step))
    i, turn = i[np.abs(turn) > 1e-9], turn[np.abs(turn) > 1e-9]
    if not len(turn):
        return None
    if metric:
        turn = turn / np.abs(turn)
    shift = b[i] - turn * a[i]
    if metric:  # the pair's own error would count as the map's
        shift = np.median((b - turn[:, None] * a).real, axis=1) + 1j * np.median(
            (b - turn[:, None] * a).imag, axis=1
        )
    error = np.abs(b - turn[:, None] * a - shift[:, None])
    best = int(np.argmin(_upper_median(error)))
    return complex(turn[best]), complex(shift[best])


def _upper_median(distance: Array) -> Array:
    """Return the order statistic of least median of squares for a line or similarity, along the last axis."""
    n = distance.shape[-1]
    rank = min(n - 1, (n + 3) // 2 - 1)
    return np.asarray(np.partition(distance, rank, axis=-1)[..., rank])


def _shortest_half(x: Array) -> tuple[float, float]:
    """Return the middle of the shortest interval with half of the values (n,), and the deviation it implies.

    Of two groups of one size, such as altitudes over two references, that of the first value is taken.
    """
    n = len(x)
    half = (n + 1) // 2
    ordered = np.sort(x)
    length = ordered[half - 1 :] - ordered[: n - half + 1]
    start = int(np.argmin(length))
    inside = (x >= ordered[start]) & (x <= ordered[start + half - 1])
    if n == 2 * half and not inside[0] and _is_group(x[~inside], float(length[start]), n):
        inside = ~inside
    middle = 0.5 * float(x[inside].min() + x[inside].max())
    return middle, _small_sample(n, 1) * float(length[start]) / (2 * _MEDIAN_OF_NORMAL)


def _is_group(x: Array, length: float, n: int) -> bool:
    """Return whether values (n / 2,) lie as close together as the interval of another group is long."""
    return float(np.ptp(x)) <= BENT_MAP * _small_sample(n, 1) * max(length, 1e-9)


def _small_sample(n: int, parameters: int) -> float:
    """Return the factor on the median's deviation for few points (Rousseeuw and Leroy 1987, section 5.1)."""
    return 1.0 + 5.0 / max(n - parameters, 1)
