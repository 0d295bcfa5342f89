"""The bare ground: a plane with hills, on which floors are painted and obstacles stand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hill:
    """A hill of Gaussian shape; a hollow if its height is negative."""

    center_m: tuple[float, float]
    radius_m: Annotated[float, Field(gt=0, le=100)]
    """Standard deviation of the Gaussian; the steepest slope is 0.61 height / radius."""
    height_m: Annotated[float, Field(ge=-50, le=50)]


@dataclass(frozen=True)
class Ground:
    """Height of the ground: z = slope . (x, y) + sum of height exp(-d^2 / (2 radius^2)) over the hills."""

    slope: tuple[float, float] = (0.0, 0.0)
    hills: tuple[Hill, ...] = ()

    def height(self, x: Array | float, y: Array | float) -> Array:
        """Return the height in metres at positions of one shape."""
        z = np.asarray(self.slope[0] * np.asarray(x) + self.slope[1] * np.asarray(y))
        for hill in self.hills:
            d2 = (x - hill.center_m[0]) ** 2 + (y - hill.center_m[1]) ** 2
            z = z + hill.height_m * np.exp(-d2 / (2 * hill.radius_m**2))
        return np.asarray(z)

    @property
    def hill_rows(self) -> Array:
        """(n, 4) x, y, radius and height of the hills, for compiled code."""
        return np.array([(*h.center_m, h.radius_m, h.height_m) for h in self.hills], float).reshape(-1, 4)


FLAT = Ground()
"""The level floor z = 0."""
