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
"""Largest difference as a share of the picture's width: correct ones differ by up to 0.02, and by 0.04 with
a read-out of 30 ms."""


def confirmed(i_H_j: Mapping[Pair, Array], camera: Camera) -> set[Pair]:
    """Return the homographies of picture j in picture i, keyed (i, j), that a second route confirms.

    The way round goes by the picture in the middle, whose halves overlap by more than the whole: where both
    are believed, they decide. On a floor that repeats, wholes that are wrong by the same piece of floor agree
    with each other. A pair without such halves is believed if it is half of any way that agrees; of those
    that no way can ask, only neighbours are, which overlap by most.
    """
    agrees = _ways(i_H_j, camera)
    believed: set[Pair] = set()
    for pair in sorted(i_H_j, key=lambda pair: pair[1] - pair[0]):
        if pair in agrees and all(half in believed for half in _halves(pair)):
            good = agrees[pair]
        else:
            told = [answer for whole, answer in agrees.items() if pair in _halves(whole)]
            good = any(told) if told else pair[1] - pair[0] == 1
        if good:
            believed.add(pair)
    return believed


def _ways(i_H_j: Mapping[Pair, Array], camera: Camera) -> dict[Pair, bool]:
    """For each pair both of whose halves there are, whether it agrees with the way by them."""
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
