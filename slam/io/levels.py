"""Conversion of pixels with more than 8 bits, of any number type, to 8 bits.

All pictures of a flight are converted alike, so that none is brighter than its neighbours. Zero stays zero as
long as that costs at most one of the eight bits, so that brightness remains proportional to light. Values far
from zero, such as the kelvins of a thermal camera, are spread over all eight bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.streams import Image

_DEPTHS = (8, 10, 12, 14, 16)
"""Bit depths of cameras, whatever the number of bits in their files."""
_SHARE_BEYOND = 0.001
"""Share of a picture's pixels that may be darker, and brighter, than the range: hot and dead pixels are
fewer.
"""

Raw = NDArray[Any]
"""Pixels as they are stored, (h, w) or (h, w, 3), of any real number type. Missing ones are NaN."""


@dataclass(frozen=True)
class Levels:
    """Range of pixel values that is converted to 0 to 255."""

    low: float
    """Value that becomes 0."""
    high: float
    """Upper end of the range. Values from here on become 255."""

    def eight_bit(self, pixels: Raw) -> Image:
        """Return pixels of 8 bits. Missing pixels become 0."""
        number = np.float32 if pixels.dtype.itemsize <= 2 else np.float64
        with np.errstate(over="ignore", invalid="ignore"):  # values may be as large as any float
            values: NDArray[Any] = pixels.astype(number)
            scaled = (values - self.low) * (256 / (self.high - self.low))
        return np.asarray(np.clip(np.nan_to_num(scaled, nan=0.0), 0, 255), dtype=np.uint8)

    def __str__(self) -> str:
        """Return the range for a message."""
        return f"{self.low:.6g} to {self.high:.6g}"


def range_of(pixels: Raw) -> tuple[float, float] | None:
    """Return the lowest and the highest value of a picture without its hot and dead pixels; None without any
    value.
    """
    known = pixels.ravel() if pixels.dtype.kind in "ui" else pixels[np.isfinite(pixels)]
    if not len(known):
        return None
    beyond = int(_SHARE_BEYOND * len(known))
    ordered = np.partition(known, sorted({beyond, len(known) - 1 - beyond}))
    return float(ordered[beyond]), float(ordered[len(known) - 1 - beyond])


def levels_of(ranges: Sequence[tuple[float, float]], integer: bool) -> Levels:
    """Return the levels for pictures with these lowest and highest values (at least one pair)."""
    low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
    if 0 <= low <= high - low or low == high == 0:
        low = 0.0
        if integer:
            bits = next((bits for bits in _DEPTHS if high < 1 << bits), int(high).bit_length())
            high = float(1 << bits)
    # A range needs a width, also for pictures of one brightness.
    width = max(high - low, abs(high) * 1e-12, 1e-30)
    return Levels(low, low + width)
