"""Photographs that a map takes to look straight down, although their own pictures contradict it.

Without an attitude a part of the map that nothing but its fixes place is taken to look down. Photographs of
the horizon match each other and fit their fixes as well as those of the ground, so they would be drawn as
ground that is not there. But what is far away hardly moves from picture to picture, where the ground below
moves by as much as the fixes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from backend.significance import FALSE_ALARM
from frontend.mosaic.view import MAX_OFF_NADIR
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.streams import Gps
from slam.core.units import length

_FARTHER = 1 / math.cos(MAX_OFF_NADIR)
"""Distance to what a part shows, over its height above the floor of the map, up to which it is drawn: that of
level ground where a tilted picture is not drawn any more. Straight down it is a valley two flying heights
deep."""


def looking_elsewhere(estimate: Estimate, flight: Flight) -> dict[int, str]:
    """Return the numbers of photographs that do not look down by their pictures, whole parts, with a reason.

    These are the parts, but for the largest, most of whose matched pairs move by the fixes, less their noise,
    more than `_FARTHER` times as far as by the pictures at their height over the floor. The floor is that of
    the largest part, whose own motion tells it.
    """
    gps, component = flight.gps, estimate.component
    if gps is None or flight.attitude is not None or not flight.all_keyframes or component.max(initial=0) < 1:
        return {}
    fix_m = _fixes(estimate, flight, gps)
    links = estimate.relative_poses
    i, j = np.array([(link.i, link.j) for link in links], dtype=np.int64).reshape(-1, 2).T
    by_pictures_m = np.array([np.linalg.norm(link.i_T_j[:3, 3]) for link in links])
    by_fixes_m = np.linalg.norm(fix_m[j] - fix_m[i], axis=1)
    # Of two fixes with normal noise in two directions (Rayleigh's distribution).
    noise_m = math.sqrt(2 * -2 * math.log(FALSE_ALARM)) * max(gps.noise_std_m[:2])
    is_far = by_fixes_m - noise_m > _FARTHER * by_pictures_m
    found: dict[int, str] = {}
    for part in range(1, int(component.max()) + 1):
        own = component[i] == part
        if 2 * is_far[own].sum() <= own.sum():
            continue
        pictures_m, fixes_m = (length(float(np.median(m[own & is_far]))) for m in (by_pictures_m, by_fixes_m))
        reason = (
            f"from picture to picture its part of the map moves by {fixes_m} according to its positions, but "
            f"only by {pictures_m} according to its pictures: it shows something far away, not the ground "
            "below"
        )
        found |= dict.fromkeys(np.flatnonzero(component == part).tolist(), reason)
    return found


def _fixes(estimate: Estimate, flight: Flight, gps: Gps) -> NDArray[np.float64]:
    """Return the fix of each keyframe (n, 2), east and north; NaN without one."""
    frames, origin = flight.frames, estimate.origin
    assert frames is not None
    assert origin is not None
    enu_m = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, origin.altitude_m, origin)[:, :2]
    stamps_s = frames.stamps_s[estimate.frame_index]
    row = np.searchsorted(gps.stamps_s, stamps_s).clip(max=len(enu_m) - 1)
    return np.where((gps.stamps_s[row] == stamps_s)[:, None], enu_m[row], np.nan)
