"""The paper's way: homographies of consecutive pictures composed, nothing else (section 3.1, equation 1)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backend.measurements import RelativePose
from frontend.camera import Camera
from frontend.lift import level_T_body, lift
from frontend.registration import Registration
from slam.mapping.level_motion import heading_of, moved_level

Array = NDArray[np.float64]


def chain(
    links: Sequence[Registration | None],
    camera: Camera,
    roll_pitch_rad: Array,
    height_m: Array,
    bridges: Sequence[RelativePose] = (),
) -> Array:
    """Poses (n, 4, 4) that best explain each keyframe's composed homography.

    The first keyframe's attitude ``roll_pitch_rad`` (n, 2) and height (n,) make metres of its canvas. A
    broken link starts a new canvas. A bridge from the keyframe before gives its heading and position; without
    one, the poses from there on are NaN.
    """
    poses = np.full((len(links), 4, 4), np.nan)
    over_gap = {bridge.j: bridge for bridge in bridges if bridge.i == bridge.j - 1}
    for first, behind in _unbroken(links):
        stretch = _composed(links[first:behind], camera, roll_pitch_rad[first], height_m[first])
        if first > 0:
            if first not in over_gap:
                break
            there = poses[first - 1] @ over_gap[first].i_T_j
            stretch = moved_level(stretch, heading_of(there), there[:2, 3])
        poses[first:behind] = stretch
    return poses


def _unbroken(links: Sequence[Registration | None]) -> list[tuple[int, int]]:
    """Return the first keyframe of each stretch of links, and the one behind it."""
    starts = [k for k, link in enumerate(links) if link is None or k == 0]
    return list(pairwise([*starts, len(links)]))


def _composed(
    links: Sequence[Registration | None], camera: Camera, roll_pitch_rad: Array, height_m: float
) -> Array:
    """Return the poses (m, 4, 4) of one stretch, whose first keyframe stands over the origin."""
    first_H_k = [np.eye(3)]
    for link in links[1:]:
        assert link is not None
        H = first_H_k[-1] @ link.i_H_j
        first_H_k.append(H / H[2, 2])
    m = len(links)
    tilt = np.tile(roll_pitch_rad, (m, 1))
    lifted = lift(np.array(first_H_k), np.tile(np.eye(8), (m, 1, 1)), camera, tilt, np.zeros((m, 2)))
    start = level_T_body(tilt[:1])[0]
    start[2, 3] = height_m
    first_T_k, _ = lifted.scale(np.full(m, height_m), np.zeros(m))
    return np.asarray(start @ first_T_k)
