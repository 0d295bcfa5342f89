"""Things that move over the floor: matches that agree with each other, in one place, and not with the floor.

Wrong matches point anywhere; those on one thing lie beside each other and are off the floor's motion by the
same. What stands on the floor and is high is off along the floor's own flow, by less than that: it does not
move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.features import Features
from frontend.homography import transfer
from frontend.matching import match

Array = NDArray[np.float64]

OFF_PX = 3.0
BESIDE, ALIKE_PX = 0.17, 1.5
"""Matches of one thing: within so much of the picture's width of each other, and off by the same."""
TOGETHER = 5
"""Of 3000 healthy pairs of pictures none had more than three."""
LEAST_SHARE, ALONG = 0.35, 0.9
"""A bent or rolling picture is off by less than this share of the flow; along it, by this cosine, is high."""


def moves(a: Features, b: Features, i_H_j: Array, width_px: int) -> bool:
    """Whether something moves by itself in a pair of pictures with the floor's homography."""
    pairs = match(a, b)
    pixel_i, pixel_j = a.pixel[pairs[:, 0]], b.pixel[pairs[:, 1]]
    off = pixel_i - transfer(i_H_j, pixel_j)
    flow = transfer(i_H_j, pixel_j) - pixel_j
    size, speed = np.linalg.norm(off, axis=1), np.linalg.norm(flow, axis=1)
    along = (off * flow).sum(axis=1) > ALONG * size * speed
    odd = (size > OFF_PX) & (size > LEAST_SHARE * speed) & ~(along & (size < speed))
    at, by = pixel_i[odd], off[odd]
    near = np.linalg.norm(at[:, None] - at, axis=2) < BESIDE * width_px
    near &= np.linalg.norm(by[:, None] - by, axis=2) < ALIKE_PX
    return bool(near.sum(axis=1).max(initial=0) >= TOGETHER)
