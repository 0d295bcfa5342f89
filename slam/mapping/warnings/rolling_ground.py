"""Ground whose waves are as long as the map: the pictures hardly tell them from a tilt of the whole map."""

from __future__ import annotations

import numpy as np

from slam.core.messages import Message, warning
from slam.core.units import length
from slam.mapping.map import Map
from slam.mapping.warnings.accuracy_basis import Shares

FEWEST_HEIGHTS = 16.0
"""Independent heights of the ground below which their spread is not known: level and tilts absorb three of
them, a fifth of the sum of squares, and chance another fifth of their deviation (1 / sqrt(2 n))."""
LEAST_SHARE = 0.25
"""Share of the variance of roll or pitch, from the flatness of the ground, from which they rest on it."""


def rolling_ground_warning(map_: Map, shares: Shares) -> Message | None:
    """Return a reason to doubt tilt and heights that rest on ground of a few long waves."""
    bundle = map_.bundle
    if bundle is None or bundle.noise.relief_inflation <= 1.0:
        return None
    optimum = bundle.optimum
    on_ground = ~optimum.problem.raised_of(len(optimum.at.point))
    on_ground &= np.bincount(optimum.problem.tracks.track[optimum.used], minlength=len(on_ground)) > 0
    heights = np.count_nonzero(on_ground) / bundle.noise.relief_inflation**2
    by_flatness = max(shares.get(axis, {}).get("flat_floor", 0.0) for axis in ("roll", "pitch"))
    if heights >= FEWEST_HEIGHTS or by_flatness < LEAST_SHARE:
        return None
    relief_m = bundle.noise.relief * optimum.transform.scale
    return warning(
        f"the ground rises and falls by {length(relief_m, map_.metric)} in waves as long as the map, which "
        "look like a tilt of the whole map: roll, pitch and heights rest on ground that is level on the "
        "whole, and may be further off than is stated",
        "record the attitude or positions, or fly over a larger area",
    )
