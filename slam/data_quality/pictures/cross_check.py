"""Consistency check of registrations: a wrong one contradicts the chain through a third picture.

A pair of pictures may be registered to the wrong part of the floor by matches that all agree. Its residual
along the path is then a hundred standard deviations, so one such pair outweighs a flight.
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
"""Largest mean difference at the corners, as a share of the picture's width. Correct registrations differ by
up to 0.02, and by 0.04 with a rolling shutter of 30 ms."""


def confirmed(i_H_j: Mapping[Pair, Array], camera: Camera) -> set[Pair]:
    """Return the homographies of picture j in picture i, keyed (i, j), that a second route confirms.

    The second route goes through the picture in the middle. The two halves overlap by more than the whole
    pair, so they decide where both are accepted. On a repetitive floor, long pairs that are wrong by the same
    displacement confirm each other. A pair without accepted halves is accepted if it is half of any route
    that closes. Pairs without any route are accepted only between neighbours, which overlap most.
    """
    closes = _loop_checks(i_H_j, camera)
    accepted: set[Pair] = set()
    for pair in sorted(i_H_j, key=lambda pair: pair[1] - pair[0]):
        if pair in closes and all(half in accepted for half in _halves(pair)):
            correct = closes[pair]
        else:
            answers = [answer for whole, answer in closes.items() if pair in _halves(whole)]
            correct = any(answers) if answers else pair[1] - pair[0] == 1
        if correct:
            accepted.add(pair)
    return accepted


def _loop_checks(i_H_j: Mapping[Pair, Array], camera: Camera) -> dict[Pair, bool]:
    """Return, for each pair whose halves both exist, whether it agrees with the product of the halves."""
    corners, most = camera.corners_px, APART * camera.size_px[0]
    found = {}
    for pair, whole in i_H_j.items():
        first, second = _halves(pair)
        if (pair[1] - pair[0]) % 2 == 0 and first in i_H_j and second in i_H_j:
            off = transfer(whole, corners) - transfer(i_H_j[first] @ i_H_j[second], corners)
            found[pair] = bool(np.linalg.norm(off, axis=1).mean() < most)
    return found


def _halves(pair: Pair) -> tuple[Pair, Pair]:
    middle = sum(pair) // 2
    return (pair[0], middle), (middle, pair[1])
