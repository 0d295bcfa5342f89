"""Obstacles: what stands on the ground, as connected ground of an elevation map above gamma_3.

Source: IMAV 2011 paper, section 3.1.1 (pixels with an elevation greater than gamma_3 show obstacles).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from frontend.elevation import Elevation

Array = NDArray[np.float64]
Index = NDArray[np.int64]

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

    @property
    def _discs(self) -> Array:
        """(n, 3) x, y and radius of each."""
        return np.array([(one.x_m, one.y_m, one.radius_m) for one in self.found]).reshape(-1, 3)

    def joined(self, others: ObstacleList) -> ObstacleList:
        """Return these with further ones. Those whose discs overlap are the same, as they are here."""
        every = list(self.found)
        same = _overlaps(self._discs, others._discs)
        for number, k in same.tolist():
            names = dict.fromkeys((*every[number].measured_by, *others.found[k].measured_by))
            every[number] = replace(every[number], measured_by=tuple(names))
        known = set(same[:, 1].tolist())
        every += [other for k, other in enumerate(others.found) if k not in known]
        above_m = min(self.above_m, others.above_m) if others.found else self.above_m
        return ObstacleList(above_m, _largest_first(every))


def _overlaps(discs: Array, others: Array) -> Index:
    """Return the numbers (p, 2) of the pairs of discs (n, 3) and others (m, 3) that overlap, in order.

    The middles of such a pair are within twice the larger radius, so the larger one finds the other.
    """
    near_others = {(i, k) for k, near in enumerate(_near(others, discs)) for i in near}
    near_discs = {(i, k) for i, near in enumerate(_near(discs, others)) for k in near}
    pair = np.array(sorted(near_others | near_discs), np.int64).reshape(-1, 2)
    here, there = discs[pair[:, 0]], others[pair[:, 1]]
    return np.asarray(pair[np.hypot(*(here - there)[:, :2].T) < here[:, 2] + there[:, 2]])


def _near(discs: Array, among: Array) -> Sequence[Sequence[int]]:
    """Return the numbers of those ``among`` other discs whose middles are within two radii of each."""
    if len(among) == 0:
        return ()
    found = cKDTree(among[:, :2]).query_ball_point(discs[:, :2], 2.0 * discs[:, 2])
    return [list(each) for each in found]


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
