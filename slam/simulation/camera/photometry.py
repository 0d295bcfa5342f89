"""Conversion of light to grey levels: vignetting, the paper's post-processing and white balance, noise.

Source: IMAV 2011 paper, section 4.1: pictures are post-processed (decreased saturation, increased brightness,
down-sampled resolution), and a filter changes the brightness randomly, with a non-linear gamma correction.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Light = NDArray[np.float32]

WHITE = 255.0
LUMA_BGR = (0.114, 0.587, 0.299)
"""Weights of the grey level of a colour (ITU-R BT.601)."""


def tones(
    stamps_s: Array, gain_std: float, gamma_std: float, correlation_s: float, rng: np.random.Generator
) -> Array:
    """Return the gains of blue, green and red and the gamma of each picture, (n, 4).

    They act as I' = white g_c (I / white)^gamma. Their logarithms are stationary Ornstein-Uhlenbeck
    processes. They are independent between pictures where ``correlation_s`` is 0.
    """
    kicks = rng.standard_normal((len(stamps_s), 4))
    with np.errstate(divide="ignore", over="ignore"):
        keep = (
            np.exp(-np.diff(stamps_s) / correlation_s) if correlation_s > 0 else np.zeros(len(stamps_s) - 1)
        )
    walk = np.empty_like(kicks)
    walk[:1] = kicks[:1]
    for k, share in enumerate(keep):
        walk[k + 1] = share * walk[k] + np.sqrt(1 - share * share) * kicks[k + 1]
    return np.exp(walk * (gain_std, gain_std, gain_std, gamma_std))


def falloff(size_px: tuple[int, int], center_px: tuple[float, float], strength: float) -> Light:
    """Return the vignetting (h, w): 1 - strength r^2, at least 0, with r = 1 in the farthest corner."""
    width, height = size_px
    x, y = np.arange(width) - center_px[0], np.arange(height) - center_px[1]
    r2 = x[None] ** 2 + y[:, None] ** 2
    return np.asarray(np.maximum(1 - strength * r2 / r2.max(), 0).astype(np.float32))


def process(light: Light, saturation: float, brightness: float) -> Light:
    """Apply the paper's post-processing of colours; 1 changes nothing."""
    if saturation == 1 and brightness == 1:
        return light
    mix = brightness * (saturation * np.eye(3) + (1 - saturation) * np.array(LUMA_BGR))
    return np.asarray(np.clip(cv2.transform(light, mix), 0, WHITE))


def apply_tone(light: Light, tone: Array) -> Light:
    """Apply the white-balance filter with gains and gamma ``tone`` (4,)."""
    light = cv2.pow(np.maximum(light, 0) / np.float32(WHITE), float(tone[3]))
    return light * (WHITE * tone[:3]).astype(np.float32)


def digitise(light: Light | Image, noise_std: float, rng: np.random.Generator) -> Image:
    """Return 8-bit grey levels with noise that is independent in each pixel and channel."""
    if noise_std == 0:
        return np.asarray(cv2.add(light, 0.0, dtype=cv2.CV_8U))
    draws = np.frombuffer(rng.bytes(2 * light.size), "<u2").reshape(light.shape)
    noise = (np.float32(noise_std) * _normal_quantiles()).take(draws)  # twice as fast as an index
    # OpenCV rounds and clips here.
    return np.asarray(cv2.add(light, noise, dtype=cv2.CV_8U))


@lru_cache(maxsize=1)
def _normal_quantiles() -> Light:
    """Return quantiles (65536,) of the normal distribution at equal steps of probability.

    A draw of one of them is four times as fast as a draw from the distribution. The standard deviation
    differs by less than 1e-4.
    """
    return ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)
