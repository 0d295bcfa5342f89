"""Velocities of photographs by the places of their neighbours, where the flight between them is straight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LONGEST_GAP = 2.5
"""Longest time to a neighbour, over the median: one photograph may be missing, while the turn to the
next strip takes longer."""
_LARGEST_BEND = np.cos(np.radians(30.0))
"""Cosine of the largest angle between the way to a photograph and the way from it on a strip."""
_LARGEST_CHANGE = 2.0
"""Largest ratio of the speeds before and after a photograph. Stamps of whole seconds that are two or three
seconds apart have one of 1.5; a vehicle that brakes at the end of a strip has a larger one."""


def straight_velocities(stamps_s: Array, place: Array) -> Array:
    """Return velocities (n, 3) at ``place`` (n, 3), in its unit per second; NaN where they are not known.

    ``stamps_s`` (n,) ascend. The velocity is that between both neighbours. At the ends of a strip it is not
    known: some vehicles stop there, and others take no notice.
    """
    n = len(stamps_s)
    velocity = np.full((n, 3), np.nan)
    if n < 2:
        return velocity
    took_s, way = np.diff(stamps_s), np.diff(place, axis=0)
    is_near = (took_s > 0) & (took_s <= _LONGEST_GAP * np.median(took_s)) & np.isfinite(way).all(axis=1)
    speed = np.full(n - 1, np.nan)
    level = way[:, :2]  # heights of photographs differ by more than a way that is straight
    speed[is_near] = np.linalg.norm(level[is_near], axis=1) / took_s[is_near]
    for k in range(1, n - 1):
        if is_near[k - 1 : k + 1].all() and _is_straight(level[k - 1], level[k], speed[k - 1], speed[k]):
            velocity[k] = (place[k + 1] - place[k - 1]) / (stamps_s[k + 1] - stamps_s[k - 1])
    return velocity


def _is_straight(before: Array, after: Array, speed_before: float, speed_after: float) -> bool:
    """Return whether the ways before and after a photograph belong to one strip, flown at one speed."""
    lengths = float(np.linalg.norm(before) * np.linalg.norm(after))
    least, most = sorted((speed_before, speed_after))
    return bool(lengths > 0 and before @ after >= _LARGEST_BEND * lengths and most <= _LARGEST_CHANGE * least)


def continued_velocities(stamps_s: Array, place: Array, velocity: Array) -> Array:
    """Return known velocities (n, 3), those at the ends of strips as if the vehicle flew on evenly there, and
    0 elsewhere.

    ``stamps_s`` and ``place`` as for `straight_velocities`, which gives the known ones.
    """
    found = np.nan_to_num(velocity)
    for k in np.flatnonzero(~np.isfinite(velocity).all(axis=1)).tolist():
        for near in (k - 1, k + 1):
            if not 0 <= near < len(place) or not np.isfinite(velocity[near]).all():
                continue
            way = (place[near] - place[k]) / (stamps_s[near] - stamps_s[k])
            along, level = way[:2], velocity[near, :2]
            if along @ level >= _LARGEST_BEND * np.linalg.norm(along) * np.linalg.norm(level):
                found[k] = way
    return found
