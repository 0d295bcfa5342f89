"""GPS fixes that contradict the other fixes, without a look at the pictures: too far, or too fast.

A fix that this check passes may still be wrong: the map compares it with the pictures
(`slam.mapping.gps.consensus`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam.core.geodesy import ecef_from_geodetic

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_SPEED_M_S = 44.7
"""Largest speed of a small unmanned aircraft, horizontal or vertical: 100 miles an hour (14 CFR 107.51)."""
CORE_SHARE = 0.7
"""Share of the fixes that are right."""
NOISE_SIGMAS = 3.0


@dataclass(frozen=True)
class FixCheck:
    """Verdict of the fixes on each other."""

    far: Mask
    """(n,) fixes farther from the connected majority than that is wide."""
    fast: Mask
    """(n,) fixes that no aircraft reaches from the majority in time."""
    jumps_up: Mask
    """(n,) fixes whose altitude no aircraft reaches in time from those of the majority."""
    distance_m: Array
    """(n,) from the nearest fix of the majority in place, 0 in it."""
    width_m: float
    """Width of the majority."""

    @property
    def consistent(self) -> Mask:
        """(n,) fixes whose place agrees with the majority."""
        return ~(self.far | self.fast)

    @property
    def altitude_consistent(self) -> Mask:
        """(n,) fixes whose place and altitude agree with the majority."""
        return self.consistent & ~self.jumps_up


def check_fixes(
    stamps_s: Array,
    latitude_deg: Array,
    longitude_deg: Array,
    altitude_m: Array,
    std_m: Array,
    stamp_error_s: float,
) -> FixCheck:
    """Compare fixes (n,) with each other.

    ``std_m`` (n, 3) are nominal deviations east, north, up of each. ``stamp_error_s`` is the resolution of
    the stamps, or infinite if they are no times.
    """
    n = len(stamps_s)
    place_m = np.full((n, 3), np.nan)
    known = np.flatnonzero(np.isfinite(latitude_deg) & np.isfinite(longitude_deg))
    place_m[known] = ecef_from_geodetic(latitude_deg[known], longitude_deg[known], 0.0)
    noise_m = NOISE_SIGMAS * np.hypot(std_m[:, 0], std_m[:, 1])
    distance = np.zeros(n)
    distance[known], width_m = _from_majority(place_m[known], noise_m[known])
    far = distance > np.maximum(width_m, 2 * noise_m)
    fast, jumps_up = np.zeros(n, bool), np.zeros(n, bool)
    if np.isfinite(stamp_error_s):
        near = np.flatnonzero(~far & np.isfinite(place_m[:, 0]))
        slack_m = MAX_SPEED_M_S * stamp_error_s
        fast[near] = ~_reachable(stamps_s[near], place_m[near], noise_m[near], slack_m)
        high = np.flatnonzero(~far & ~fast & np.isfinite(altitude_m))
        noise_m = NOISE_SIGMAS * std_m[:, 2]
        jumps_up[high] = ~_reachable(stamps_s[high], altitude_m[high, None], noise_m[high], slack_m)
    return FixCheck(far, fast, jumps_up, distance, width_m)


def _from_majority(place_m: Array, noise_m: Array) -> tuple[Array, float]:
    """Return the distance of each place (n, 3) from the connected majority, 0 in it, and the latter's width.

    The majority grows from the places nearest to the median, by steps no longer than these are wide, or than
    the noise (n,) of a place is.
    """
    n = len(place_m)
    if n < 4:  # of three fixes no two are a majority
        return np.zeros(n), np.inf
    from_median = np.linalg.norm(place_m - np.median(place_m, axis=0), axis=1)
    core = np.argsort(from_median, kind="stable")[: max(2, int(np.ceil(CORE_SHARE * n)))]
    width_m = 2.0 * max(float(from_median[core].max()), float(np.median(noise_m)))
    reach_m = np.maximum(width_m, 2.0 * noise_m)
    inside = np.zeros(n, bool)
    inside[core] = True
    distance = np.zeros(n)
    while not inside.all():
        outside = np.flatnonzero(~inside)
        away, _ = cKDTree(place_m[inside]).query(place_m[outside])
        distance[outside] = away
        joins = away <= reach_m[outside]
        if not joins.any():
            break
        inside[outside[joins]] = True
        distance[inside] = 0.0
    return distance, width_m


def _reachable(stamps_s: Array, place_m: Array, noise_m: Array, slack_m: float) -> Mask:
    """Return the longest chain in time whose steps are no faster than `MAX_SPEED_M_S`, as a mask (n,).

    A step may be longer by ``slack_m`` and by the noise (n,) of both places.
    Runs of consecutive places that are within reach are joined first, so that few are left to compare.
    """
    n = len(stamps_s)
    order = np.argsort(stamps_s, kind="stable")
    t, p, noise = stamps_s[order], place_m[order], noise_m[order]
    step_m = np.linalg.norm(np.diff(p, axis=0), axis=1)
    ends = np.flatnonzero(step_m > MAX_SPEED_M_S * np.diff(t) + np.hypot(noise[1:], noise[:-1]) + slack_m)
    begin, end = np.append(0, ends + 1), np.append(ends, max(n - 1, 0))
    length = (end - begin + 1).astype(float)
    total, before = length.copy(), np.full(len(begin), -1)
    for k in range(1, len(begin)):
        distance = np.linalg.norm(p[begin[k]] - p[end[:k]], axis=1)
        longest = MAX_SPEED_M_S * (t[begin[k]] - t[end[:k]]) + np.hypot(noise[begin[k]], noise[end[:k]])
        joined = np.flatnonzero(distance <= longest + slack_m)
        if len(joined):
            before[k] = joined[int(np.argmax(total[joined]))]
            total[k] += total[before[k]]
    good = np.zeros(n, bool)
    k = int(np.argmax(total))
    while k >= 0:
        good[order[begin[k] : end[k] + 1]] = True
        k = int(before[k])
    return good
