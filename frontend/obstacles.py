"""Obstacles: what stands on the ground, as connected ground of an elevation map above gamma_3.

Source: IMAV 2011 paper, section 3.1.1 (pixels with an elevation greater than gamma_3 show obstacles).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.elevation import Elevation

_TOP_PERCENT = 95.0
"""Percentile of the heights of an obstacle that counts as its height: a few cells may be wrong."""


@dataclass(frozen=True)
class Obstacle:
    """One thing that stands on the ground."""

    x_m: float
    y_m: float
    """Middle of the ground that it covers."""
    height_m: float
    """Height of its top over the floor."""
    area_m2: float
    """Area of that ground."""
    measured_by: tuple[str, ...]
    """Instruments that show it: ``pictures``, ``sonar``."""

    @property
    def radius_m(self) -> float:
        """Radius of a disc of its area."""
        return float(np.sqrt(self.area_m2 / np.pi))

    def overlaps(self, other: Obstacle) -> bool:
        """Return whether discs of the areas of both overlap."""
        apart = np.hypot(self.x_m - other.x_m, self.y_m - other.y_m)
        return bool(apart < self.radius_m + other.radius_m)


@dataclass(frozen=True)
class ObstacleList:
    """All things that stand on the ground of a map."""

    above_m: float
    """Height over the floor from which ground counts as one of them."""
    found: tuple[Obstacle, ...]
    """The largest first."""

    @property
    def by_pictures(self) -> tuple[Obstacle, ...]:
        """Those that the pictures show."""
        return tuple(one for one in self.found if "pictures" in one.measured_by)

    def joined(self, others: ObstacleList) -> ObstacleList:
        """Return these with further ones; those that overlap are the same, as these show it."""
        every = list(self.found)
        for other in others.found:
            same = [k for k in range(len(self.found)) if every[k].overlaps(other)]
            for k in same:
                names = dict.fromkeys((*every[k].measured_by, *other.measured_by))
                every[k] = replace(every[k], measured_by=tuple(names))
            if not same:
                every.append(other)
        above_m = min(self.above_m, others.above_m) if others.found else self.above_m
        return ObstacleList(above_m, _largest_first(every))


def standing_on(
    elevation: Elevation, above_m: float, measured_by: Mapping[str, NDArray[np.bool_]]
) -> ObstacleList:
    """Return what stands higher than ``above_m`` on the ground of an elevation map.

    ``measured_by``: names of instruments -> cells (rows, cols) that each measured. What is less wide
    than that height is no obstacle: single heights may be wrong.
    """
    with np.errstate(invalid="ignore"):
        high = elevation.height_m > above_m
    count, label, stats, middle = cv2.connectedComponentsWithStats(high.astype(np.uint8), connectivity=4)
    area_m2 = stats[:, cv2.CC_STAT_AREA] * elevation.gsd_m**2
    found = []
    for k in range(1, count):
        if area_m2[k] < above_m**2:
            continue
        col, row, width, height = stats[k, :4]
        window = slice(row, row + height), slice(col, col + width)
        inside = label[window] == k
        found.append(
            Obstacle(
                x_m=float(elevation.west_m + (middle[k, 0] + 0.5) * elevation.gsd_m),
                y_m=float(elevation.north_m - (middle[k, 1] + 0.5) * elevation.gsd_m),
                height_m=float(np.percentile(elevation.height_m[window][inside], _TOP_PERCENT)),
                area_m2=float(area_m2[k]),
                measured_by=tuple(name for name, cells in measured_by.items() if cells[window][inside].any()),
            )
        )
    return ObstacleList(above_m, _largest_first(found))


def _largest_first(found: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    return tuple(sorted(found, key=lambda one: -one.area_m2))
