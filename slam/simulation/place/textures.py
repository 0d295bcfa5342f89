"""Textures of obstacles: a picture of the top and one of the side, with mip levels, in one buffer."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.simulation.place.obstacles import BASE, HALF_LENGTH, HALF_WIDTH, ROUND, TAPER_WIDTH, TOP
from slam.simulation.place.weathering import apply_weathering, draw_weathering

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

METRES_PER_TEXEL = 0.004
MAX_SIDE_PX = 1500
LEVELS = 6
BANDS_M = 0.15
"""Width of the bands around a pylon."""
PAINT_BGR = np.array([(52, 58, 168), (60, 128, 196), (150, 108, 62), (92, 132, 78), (96, 140, 178)], np.uint8)
"""Colours of gym boxes and mats: red, orange, blue, green and bare wood."""
LEAF_BGR, LEAVES_PER_M2 = (48, 104, 62), 2000
BAND_BGR = ((48, 52, 190), (214, 216, 220))
SIDE_LIGHT = (0.62, 0.80, 0.72, 0.50)
"""Brightness of the side faces relative to the top, counter-clockwise from the front; light comes from
above."""


@dataclass(frozen=True)
class ObstacleTextures:
    """The pictures on all obstacles, in one buffer."""

    texels: Image
    """(n, 3) BGR, rows of all pictures one after the other."""
    levels: NDArray[np.int64]
    """(obstacles, 2, ``LEVELS``, 3): first texel, height, width; top and side."""


def draw_textures(prisms: Array, seed: int) -> ObstacleTextures:
    """Return textures of prisms (n, 11), all different and reproducible from the seed."""
    texels: list[Image] = []
    levels = np.empty((len(prisms), 2, LEVELS, 3), np.int64)
    first = 0
    for k, prism in enumerate(prisms):
        for face, picture in enumerate(_pictures(prism, np.random.default_rng((seed, k)))):
            for level in range(LEVELS):
                levels[k, face, level] = first, *picture.shape[:2]
                texels.append(picture.reshape(-1, 3))
                first += len(texels[-1])
                half = (max(1, picture.shape[1] // 2), max(1, picture.shape[0] // 2))
                picture = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)
    return ObstacleTextures(np.concatenate(texels) if texels else np.empty((0, 3), np.uint8), levels)


def _pictures(prism: Array, rng: np.random.Generator) -> tuple[Image, Image]:
    height_m = prism[TOP] - prism[BASE]
    if prism[TAPER_WIDTH] > 0:  # the side leans: a roof, or a tree
        height_m = float(np.hypot(height_m, prism[TAPER_WIDTH] * prism[HALF_WIDTH]))
    if prism[ROUND] and prism[TAPER_WIDTH] > 0:
        leaves = _leaves(2 * np.pi * prism[HALF_LENGTH], height_m, rng)
        return leaves[:4, :4], leaves
    if prism[ROUND]:
        return _disc(prism[HALF_LENGTH], rng), _bands(2 * np.pi * prism[HALF_LENGTH], height_m, rng)
    length_m, width_m = 2 * prism[HALF_LENGTH], 2 * prism[HALF_WIDTH]
    paint_bgr = PAINT_BGR[rng.integers(len(PAINT_BGR))]
    faces = [
        (_panel(run, height_m, paint_bgr, rng) * light).astype(np.uint8)
        for run, light in zip((width_m, length_m, width_m, length_m), SIDE_LIGHT, strict=True)
    ]
    rows = faces[0].shape[0]
    side = np.hstack([cv2.resize(face, (face.shape[1], rows)) for face in faces])
    return _panel(length_m, width_m, paint_bgr, rng), side


def _panel(width_m: float, height_m: float, paint_bgr: Image, rng: np.random.Generator) -> Image:
    """Draw a worn board with a rim, stickers and lettering."""
    picture = _worn_surface(width_m, height_m, paint_bgr, rng)
    h, w = picture.shape[:2]
    for _ in range(int(rng.integers(3, 7))):
        at = (rng.uniform(0.05, 0.85, 2) * (w, h)).astype(int)
        size = np.maximum((rng.uniform(0.08, 0.22, 2) * min(w, h)).astype(int), 2)
        shade = int(rng.choice([35, 70, 200, 235]))
        cv2.rectangle(picture, at.tolist(), (at + size).tolist(), (shade,) * 3, -1)
    text = "".join(rng.choice(list("ABCDEFGHKLMNPRSTUVXYZ0123456789"), 4))
    cv2.putText(
        picture,
        text,
        (int(0.12 * w), int(0.72 * h)),
        cv2.FONT_HERSHEY_DUPLEX,
        max(0.004 * min(w, h), 0.1),
        (240, 240, 240),
        max(1, min(w, h) // 60),
        cv2.LINE_AA,
    )
    cv2.rectangle(picture, (0, 0), (w - 1, h - 1), (30, 34, 38), max(1, min(w, h) // 40))
    return picture


def _bands(around_m: float, height_m: float, rng: np.random.Generator) -> Image:
    """Draw red and white bands, darker on the side away from the light."""
    picture = _worn_surface(around_m, height_m, np.full(3, 128, np.uint8), rng).astype(np.float32) / 128
    rows, cols = picture.shape[:2]
    band = (np.arange(rows) * height_m / rows // BANDS_M).astype(int) % 2
    picture *= np.array(BAND_BGR, np.float32)[band][:, None]
    light = 0.66 + 0.16 * np.cos(2 * np.pi * np.arange(cols) / cols - 1.2)
    return np.asarray(np.clip(picture * light[None, :, None], 0, 255).astype(np.uint8))


def _leaves(around_m: float, height_m: float, rng: np.random.Generator) -> Image:
    """Draw leaves in light and shadow: blobs of many greens."""
    picture = _worn_surface(around_m, height_m, np.array(LEAF_BGR, np.uint8), rng)
    rows, cols = picture.shape[:2]
    for _ in range(int(LEAVES_PER_M2 * around_m * height_m)):
        at = (int(rng.integers(cols)), int(rng.integers(rows)))
        shade = np.clip(np.array(LEAF_BGR) * rng.uniform(0.4, 1.7), 0, 255).astype(int)
        cv2.circle(picture, at, int(rng.integers(1, 5)), shade.tolist(), -1, cv2.LINE_AA)
    return picture


def _disc(radius_m: float, rng: np.random.Generator) -> Image:
    """Draw rings with a notch that shows the orientation."""
    picture = _worn_surface(2 * radius_m, 2 * radius_m, np.array(BAND_BGR[0], np.uint8), rng)
    n = len(picture)
    middle = (n // 2, n // 2)
    cv2.circle(picture, middle, round(0.34 * n), BAND_BGR[1], -1, cv2.LINE_AA)
    cv2.circle(picture, middle, round(0.16 * n), (40, 40, 44), -1, cv2.LINE_AA)
    cv2.line(picture, middle, (n - 1, n // 3), (40, 40, 44), max(1, n // 14), cv2.LINE_AA)
    return picture


def _worn_surface(width_m: float, height_m: float, paint_bgr: Image, rng: np.random.Generator) -> Image:
    """Draw a worn surface of one colour with texels of about ``METRES_PER_TEXEL``."""
    w, h = (int(np.clip(np.ceil(s / METRES_PER_TEXEL), 4, MAX_SIDE_PX)) for s in (width_m, height_m))
    picture = np.empty((h, w, 3), np.uint8)
    picture[:] = paint_bgr
    apply_weathering(picture, draw_weathering(h, w, METRES_PER_TEXEL, rng))
    return picture
