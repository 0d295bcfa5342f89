"""The floor of a sports hall: worn planks with the lines of its courts.

Source: IMAV 2011 paper, figure 1 (a gym with realistic ground texture).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.simulation.place.weathering import apply_weathering, draw_weathering

Image = NDArray[np.uint8]

PLANK_M = (0.9, 0.07)
"""Length and width of a plank."""
WOOD_BGR = (104, 150, 190)
LINES_BGR = ((225, 228, 230), (150, 84, 48), (60, 60, 176), (70, 170, 210))
LINE_M = 0.05


def gym_floor(width: int, height: int, metres_per_px: float, rng: np.random.Generator) -> Image:
    """Draw the floor as (height, width, 3) BGR."""
    texture = _planks(width, height, metres_per_px, rng)
    _lines(texture, metres_per_px, rng)
    apply_weathering(texture, draw_weathering(height, width, metres_per_px, rng))
    return texture


def _planks(width: int, height: int, metres_per_px: float, rng: np.random.Generator) -> Image:
    """Draw rows of planks along x, each with its own shade and grain, with dark joints."""
    length, breadth = (side / metres_per_px for side in PLANK_M)
    row = (np.arange(height) / breadth).astype(int)
    offset = rng.uniform(0, length, row[-1] + 1)
    place = (np.arange(width)[None] + offset[:, None]) / length
    shade = rng.normal(1.0, 0.07, (row[-1] + 1, int(np.ceil(width / length)) + 2))
    by_row = np.take_along_axis(shade, place.astype(int), 1)
    joint = (place % 1.0) * length < max(1.0, 0.002 / metres_per_px)
    by_row = np.where(joint, 0.45, by_row)
    # Grain: streaks twenty times as long as wide.
    grain = rng.normal(0.0, 0.06, (height, width // 20 + 2)).astype(np.float32)
    grain = cv2.resize(grain, (width, height), interpolation=cv2.INTER_LINEAR)
    brightness = by_row.astype(np.float32)[row] + grain
    seam = np.arange(height) % breadth < max(1.0, 0.002 / metres_per_px)
    brightness[seam] *= 0.55
    return np.asarray(
        np.clip(brightness[..., None] * np.array(WOOD_BGR, np.float32), 0, 255).astype(np.uint8)
    )


def _lines(texture: Image, metres_per_px: float, rng: np.random.Generator) -> None:
    """Draw the lines of several courts: straight lines in both directions, and circles."""
    height, width = texture.shape[:2]
    thick = max(1, round(LINE_M / metres_per_px))
    for axis, span in ((0, width), (1, height)):
        at = rng.uniform(0.3, 1.2) / metres_per_px
        while at < span:
            colour = LINES_BGR[rng.integers(len(LINES_BGR))]
            begin = (round(at), 0) if axis == 0 else (0, round(at))
            end = (begin[0], height) if axis == 0 else (width, begin[1])
            cv2.line(texture, begin, end, colour, thick)
            at += rng.uniform(1.0, 2.4) / metres_per_px
    for _ in range(max(1, round(height * width * metres_per_px**2 / 12))):
        middle = (round(rng.uniform(0, width)), round(rng.uniform(0, height)))
        radius = round(rng.uniform(0.5, 1.8) / metres_per_px)
        cv2.circle(texture, middle, radius, LINES_BGR[rng.integers(len(LINES_BGR))], thick, cv2.LINE_AA)
