"""The paper's way: homographies of consecutive pictures composed, nothing else (section 3.1, equation 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.lift import level_T_body, lift
from frontend.registration import Registration

Array = NDArray[np.float64]


def chain(
    links: Sequence[Registration | None], camera: Camera, roll_pitch_rad: Array, height_m: Array
) -> Array:
    """Poses (n, 4, 4) that best explain each keyframe's composed homography; NaN behind a broken link.

    The first keyframe's attitude ``roll_pitch_rad`` (n, 2) and height (n,) make metres of its canvas; each
    stretch behind a broken link starts at the origin again, so only the first is given.
    """
    n = len(links)
    poses = np.full((n, 4, 4), np.nan)
    if n == 0:
        return poses
    first_H_k = [np.eye(3)]
    for link in links[1:]:
        if link is None:
            break
        H = first_H_k[-1] @ link.i_H_j
        first_H_k.append(H / H[2, 2])
    H = np.array(first_H_k)
    m = len(H)
    tilt = np.repeat(roll_pitch_rad[:1], m, axis=0)
    lifted = lift(H, np.tile(np.eye(8), (m, 1, 1)), camera, tilt, np.zeros((m, 2)))
    start = level_T_body(tilt[:1])[0]
    start[2, 3] = height_m[0]
    first_T_k, _ = lifted.scale(np.full(m, height_m[0]), np.zeros(m))
    poses[:m] = start @ first_T_k
    return poses
