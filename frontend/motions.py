"""Which motion in a pair of pictures is the floor's, where something else moves in them too.

A landing gear, a shadow's edge or a vehicle that drives through may carry more features than the floor, so
that the largest number of matches is not the floor's. The floor is what fills most of the picture: of two
motions the one whose matches cover more of it is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from frontend.cells import cells
from frontend.homography import HomographyConfig, HomographyFit, fit_homography

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ELSEWHERE = 0.4
"""A second motion is looked for where matches that do not agree fill cells of their own, this many for each
cell of those that agree."""
_LEAST, _ITERATIONS = 15, 300


@dataclass(frozen=True)
class FloorMotion:
    """The floor's homography in a pair of pictures."""

    fit: HomographyFit
    elsewhere: Mask
    """(m,) matches that agree on another motion."""
    other_i_H_j: Array | None
    """(3, 3) that motion; None where there is no other."""


def floor_motion(
    pixel_i: Array,
    pixel_j: Array,
    corners_px: Array,
    size_px: tuple[int, int],
    config: HomographyConfig = HomographyConfig(),
) -> FloorMotion | None:
    """As `fit_homography`, of matches (m, 2) and (m, 2); None where no plane explains them."""
    most = fit_homography(pixel_i, pixel_j, corners_px, config)
    if most is None:
        return None
    alone = FloorMotion(most, np.zeros(len(pixel_i), dtype=bool), None)
    cell = cells(pixel_j, size_px)
    inside, outside = set(cell[most.inlier].tolist()), set(cell[~most.inlier].tolist())
    rest = np.flatnonzero(~most.inlier)
    if len(outside - inside) <= ELSEWHERE * len(inside) or len(rest) < _LEAST:
        return alone
    quick = replace(config, max_iterations=min(config.max_iterations, _ITERATIONS))
    found = fit_homography(pixel_i[rest], pixel_j[rest], corners_px, quick)
    if found is None or found.inlier.sum() < _LEAST:
        return alone
    inlier = np.zeros(len(pixel_i), dtype=bool)
    inlier[rest[found.inlier]] = True
    second = replace(found, inlier=inlier)
    first_is_floor = len(inside) >= len(set(cell[inlier].tolist()))
    floor, other = (most, second) if first_is_floor else (second, most)
    return FloorMotion(floor, other.inlier, other.i_H_j)
