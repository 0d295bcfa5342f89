"""A floor of lines alone: one colour with the painted lines of a court, and nothing else to see.

Between two cross lines a picture shows parallel lines. Motion along them leaves it unchanged (the aperture
problem).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

FLOOR_BGR, LINE_BGR = (78, 120, 62), (228, 232, 230)
LINE_M = 0.05
"""Width of a line, as rules of most courts have it."""
ALONG_M, ACROSS_M = (0.6, 1.6), (2.4, 4.2)
"""Least and largest distance between two lines along x, and between two lines along y."""


def lines_floor(width: int, height: int, metres_per_px: float, rng: np.random.Generator) -> Image:
    """Draw the floor as (height, width, 3) BGR: many lines along x, few across."""
    texture = np.full((height, width, 3), FLOOR_BGR, np.uint8)
    thick = max(1, round(LINE_M / metres_per_px))
    for row in _places(height, ALONG_M, metres_per_px, rng):
        texture[row : row + thick] = LINE_BGR
    for column in _places(width, ACROSS_M, metres_per_px, rng):
        texture[:, column : column + thick] = LINE_BGR
    return texture


def _places(
    size: int, between_m: tuple[float, float], metres_per_px: float, rng: np.random.Generator
) -> list[int]:
    """Return the first texel of each line over a side of ``size`` texels."""
    count = int(size * metres_per_px / between_m[0]) + 1
    apart_m = rng.uniform(*between_m, count)
    at = (np.cumsum(apart_m) - rng.uniform(0, apart_m[0])) / metres_per_px
    return [int(place) for place in at[at < size]]
