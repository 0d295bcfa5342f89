"""The scatter of measured heights over a flat floor: what differs less cannot be told from the floor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from frontend.robust import robust_std
from slam.core.units import SPACE

SURE = 3.0
"""Standard deviations that noise exceeds in one cell of 400."""
LEAST_SPAN_M = 0.1
"""Range of the colours on a flat floor, half of it below the floor, so that noise does not look like
hills."""


class FloorScatter(NamedTuple):
    """Heights between which a flat floor scatters by chance."""

    lowest_m: float
    highest_m: float
    """``SURE`` standard deviations to either side of the middle."""

    @property
    def middle_m(self) -> float:
        """The height of the floor among them."""
        return (self.lowest_m + self.highest_m) / 2

    @property
    def std_m(self) -> float:
        """Their standard deviation."""
        return (self.highest_m - self.lowest_m) / (2 * SURE)

    def __str__(self) -> str:
        return f"{1e3 * self.lowest_m:+.0f} to {1e3 * self.highest_m:+.0f}{SPACE}mm"


def floor_scatter(height: NDArray[np.float32]) -> FloorScatter | None:
    """Return the scatter of a flat floor by the median of its deviations; None where these are too large for
    noise, as on hills."""
    known = height[np.isfinite(height)]
    if len(known) == 0:
        return None
    middle = float(np.median(known))
    reach = SURE * robust_std(known - middle)
    return FloorScatter(middle - reach, middle + reach) if reach < LEAST_SPAN_M / 2 else None
