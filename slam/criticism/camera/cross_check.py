"""Registrations held against each other: a wrong one agrees with no way round by other pictures.

A pair of pictures may be registered to the wrong part of the floor by matches that all agree. What it
then says of the path is off by a hundred deviations, and one such pair outweighs a flight.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.homography import transfer

Array = NDArray[np.float64]
Pair = tuple[int, int]

APART = 0.06
"""Of a picture's width: right ones differ by up to 0.02, and by 0.04 where rows are read out over 30 ms."""


def confirmed(i_H_j: Mapping[Pair, Array], camera: Camera) -> set[Pair]:
    """Of homographies of picture j in picture i, keyed (i, j), those that some way round agrees with.

    The way from i to j goes by the picture in the middle; a pair is asked as the whole and as a half of such
    ways. Of those that no way can ask, only neighbours are believed: they overlap by most.
    """
    asked: dict[Pair, list[bool]] = {pair: [] for pair in i_H_j}
    corners, most = camera.corners_px, APART * camera.size_px[0]
    for (i, j), whole in i_H_j.items():
        middle = (i + j) // 2
        halves = (i, middle), (middle, j)
        if (j - i) % 2 or not all(half in i_H_j for half in halves):
            continue
        round_about = i_H_j[halves[0]] @ i_H_j[halves[1]]
        off = np.linalg.norm(transfer(whole, corners) - transfer(round_about, corners), axis=1)
        agrees = bool(off.mean() < most)
        for pair in ((i, j), *halves):
            asked[pair].append(agrees)
    return {
        pair for pair, answers in asked.items() if any(answers) or (not answers and pair[1] - pair[0] == 1)
    }
