"""Traces of use on a floor or an obstacle, which distinguish one place from the next."""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

Image = NDArray[np.uint8]

NEUTRAL = 128
"""Value of the weathering that changes nothing."""
WEATHERING_CONTRAST = 0.16
"""Standard deviation of the weathering, relative to the brightness."""
SPECKS_PER_M2 = 200
SPECK_RADIUS_M = (0.0015, 0.006)
SCRATCHES_PER_M2 = 7


def apply_weathering(texture: Image, weathering: Image) -> None:
    """Darken and brighten ``texture`` (h, w, 3) in place by ``weathering`` (h, w)."""
    for channel in range(3):
        texture[..., channel] = cv2.multiply(texture[..., channel], weathering, scale=1 / NEUTRAL)


def draw_weathering(height: int, width: int, metres_per_px: float, rng: np.random.Generator) -> Image:
    """Draw stains and grain, specks and scratches as a brightness (height, width) around ``NEUTRAL``.

    Stains and grain have the spectrum of natural pictures: the amplitude falls with frequency, with equal
    power in each octave from 1.2 m down to the texel. They are periodic, so a tile of them repeats
    seamlessly.
    """
    spectrum = scipy.fft.rfft2(rng.standard_normal((height, width), dtype=np.float32))
    fy = scipy.fft.fftfreq(height, metres_per_px).astype(np.float32)[:, None]
    fx = scipy.fft.rfftfreq(width, metres_per_px).astype(np.float32)[None]
    spectrum /= np.hypot(np.hypot(fx, fy), np.float32(1 / 1.2))
    spectrum[0, 0] = 0
    stains = scipy.fft.irfft2(spectrum, (height, width), overwrite_x=True)
    stains *= NEUTRAL * WEATHERING_CONTRAST / stains.std()
    stains += NEUTRAL
    weathering = np.clip(stains, 30, 225, out=stains).astype(np.uint8)
    area_m2 = height * width * metres_per_px**2
    for _ in range(int(SPECKS_PER_M2 * area_m2)):
        _speck(weathering, metres_per_px, rng)
    for _ in range(int(SCRATCHES_PER_M2 * area_m2)):
        _scratch(weathering, metres_per_px, rng)
    return weathering


def _scratch(weathering: Image, metres_per_px: float, rng: np.random.Generator) -> None:
    """Draw a bent line of some centimetres, clipped at the border."""
    height, width = weathering.shape
    turn = rng.uniform(0, 2 * np.pi) + np.linspace(0, rng.normal(0, 0.7), 12)
    step = rng.uniform(0.03, 0.30) / 12 / metres_per_px
    points = rng.uniform(0, [width, height]) + np.cumsum(
        step * np.column_stack([np.cos(turn), np.sin(turn)]), 0
    )
    shade, thickness = (
        int(rng.choice([60, 85, 175, 200])),
        max(1, round(rng.uniform(0.001, 0.004) / metres_per_px)),
    )
    cv2.polylines(weathering, [np.int32(points * 16)], False, shade, thickness, cv2.LINE_AA, 4)


def _speck(weathering: Image, metres_per_px: float, rng: np.random.Generator) -> None:
    """Draw a dark or bright disc of some millimetres.

    A floor has tens of thousands: scalars from ``rng.random`` cost a tenth of ``uniform`` and ``choice``.
    """
    height, width = weathering.shape
    at = (round(width * rng.random() * 16), round(height * rng.random() * 16))
    smallest, largest = SPECK_RADIUS_M
    radius = (smallest + (largest - smallest) * rng.random()) / metres_per_px
    shades = (rng.integers(40, 90), rng.integers(165, 215))
    shade = int(shades[rng.integers(2)])
    cv2.circle(weathering, at, round(radius * 16), shade, -1, cv2.LINE_AA, 4)
