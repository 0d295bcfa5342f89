"""Extents of a mosaic: all ground that its pictures show, or less of it where that is too much.

The far ground of a tilted picture is large, and few pixels show it. If it counted as other ground does, one
such picture would make the pixels of the whole mosaic coarser. A mosaic that would have too many pixels
therefore goes without the ground that its pictures show most coarsely, and with no more of it than needed.
Ground always counts if its picture resolves it as finely as the mosaic, or at most ``MAX_ENLARGED`` times as
coarsely as if it looked straight down. Pictures that look down keep all their ground, from any height.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.view import MAX_OFF_NADIR, MosaicView, bounds_of, clipped

Array = NDArray[np.float64]

CANVAS_RATIO = 4.0
"""Largest number of pixels of a mosaic for one pixel of its pictures. A canvas that exceeds it because groups
of pictures lie apart goes without the smaller groups."""
MAX_ENLARGED = CANVAS_RATIO**0.5
"""The same along the side of a pixel, for ground that a tilted picture shows."""
COARSEST = np.cos(MAX_OFF_NADIR) ** -1.5
"""Ground sample distance where ground is no longer used, over that straight below."""
STEPS = 10
"""Number of smaller extents that are tried: the limit of one is less than a ninth below that of another."""


def offered_extents(views: Sequence[MosaicView], gsd_m: float) -> list[Array]:
    """Return bounds (4,) of ground, of all first and at last of that which always counts for ``gsd_m``."""
    offered = [union(np.array([view.bounds_m for view in views]))]
    tilted = [view for view in views if not _counts_whole(view)]
    others = [view.bounds_m for view in views if _counts_whole(view)]
    for enlarged in np.geomspace(COARSEST, MAX_ENLARGED, STEPS) if tilted else ():
        outlines = [view.outline_within(max(gsd_m, enlarged * view.nadir_gsd_m)) for view in tilted]
        seen = [bounds_of(outline) for outline in outlines if len(outline)]
        if seen or others:
            offered.append(intersection(union(np.array(seen + others)), offered[0]))
    return offered


def native_gsd_m(views: Sequence[MosaicView]) -> float:
    """Return the median ground sample distance of the pictures that look down, of all if none does.

    Their whole ground counts always.
    """
    down = [view.gsd_m for view in views if _counts_whole(view)]
    return float(np.median(down or [view.gsd_m for view in views]))


def share_within(view: MosaicView, extent_m: Array) -> float:
    """Return the share of the floor in a picture that lies within bounds (4,)."""
    west, south, east, north = extent_m
    inside = view.outline_m
    for line in ((1.0, 0.0, -west), (-1.0, 0.0, east), (0.0, 1.0, -south), (0.0, -1.0, north)):
        inside = clipped(inside, np.array(line))
    return _polygon_area(inside) / _polygon_area(view.outline_m)


def intersection(a: Array, b: Array) -> Array:
    """Return the bounds (4,) of what two bounds have in common."""
    return np.concatenate([np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])])


def union(bounds: Array) -> Array:
    """Return the bounds (4,) that hold all of some bounds (n, 4)."""
    return np.concatenate([bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)])


def _counts_whole(view: MosaicView) -> bool:
    return view.outline_within(MAX_ENLARGED * view.nadir_gsd_m) is view.outline_m


def _polygon_area(points: Array) -> float:
    """Return the area of a polygon (n, 2), by the shoelace formula."""
    (x, y), (x1, y1) = points.T, np.roll(points, -1, axis=0).T
    return abs(float((x * y1 - x1 * y).sum())) / 2
