"""Check of picture type and size, and the sizes to which a picture is reduced when it is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

REDUCTIONS = (1, 2, 4, 8)
"""Ratios of whole pictures to those that a decoder of JPEG gives without decoding the rest: the shares of its
blocks of 8 x 8 pixels."""


def reduced_size(size_px: tuple[int, int], side_px: int) -> tuple[int, int]:
    """Return the smallest (width, height) by ``REDUCTIONS`` whose longer side has at least ``side_px``.

    Only reductions without a remainder count: the pixels at the far edges would stand for less otherwise.
    """
    width, height = size_px
    fits = [n for n in REDUCTIONS if max(size_px) >= n * side_px and not (width % n or height % n)]
    return width // max(fits, default=1), height // max(fits, default=1)


def unusable_reason(
    picture: NDArray[np.uint8], size_px: tuple[int, int], reductions: Sequence[int] = (1,)
) -> str:
    """Return why a picture is unusable for a camera of ``size_px`` (width, height); empty if it is usable.

    It may be smaller by one of the ``reductions``.
    """
    if picture.dtype != np.uint8 or picture.shape[2:] not in ((), (3,)):
        return "neither 8-bit grey nor colour"
    height, width = picture.shape[:2]
    if size_px not in [(n * width, n * height) for n in reductions]:
        return "of another size than the camera's"
    return ""
