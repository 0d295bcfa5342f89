"""Things that stand on the ground of a mosaic, such as houses: each is taken from one picture as a whole.

Heights of edges are the least certain, and a wall is in none of the pictures where the surface has it. A seam
over a roof would show both; on the ground around it shows neither.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.canvas import CELL_PX, SOFT_CELLS, MosaicGrid
from frontend.mosaic.surface import Surface
from frontend.mosaic.view import Lattice, MosaicView

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

Box = tuple[slice, slice]
"""Rows and columns of a structure and of the cells beside it."""
Weigh = Callable[[MosaicView, Lattice], Float32]
"""Function of a picture and a lattice: its weight (rows, cols) there, 0 where it does not see the ground."""

_LEAST_CELLS = 2.0
"""Least height of a structure in cells of the surface. Two are about four pixels, which two pictures that lie
apart by 0.4 of their height displace by 1.6 px where the surface lacks them."""
_SURE = 3.0
"""The same in standard deviations of the heights."""


def structures(surface: Surface, canvas: MosaicGrid, side_m: float) -> tuple[NDArray[np.int32], list[Box]]:
    """Return the number of the structure in each cell (rows, cols), 0 for none, and the box of each.

    A structure is narrower than ``side_m``. It stands out from an opening of the heights (Serra 1982,
    chapter 10), which leaves slopes.
    """
    cell_m = CELL_PX * canvas.gsd_m
    lattice = canvas.lattice(0, 0, *canvas.cell_shape, CELL_PX)
    # In the middles of the cells, where the weights are those of the owners too.
    height_m = _over_plane(surface.nearest(lattice, surface.height_m))
    square = np.ones((max(1, round(side_m / cell_m)),) * 2, np.uint8)
    ground = cv2.morphologyEx(height_m, cv2.MORPH_OPEN, square)
    std_m = surface.std_m[np.isfinite(surface.std_m)]
    least_m = max(_LEAST_CELLS * surface.cell_m, _SURE * float(np.median(std_m)) if len(std_m) else 0.0)
    stands = np.isfinite(height_m) & (height_m > ground + least_m)
    _, label, stats, _ = cv2.connectedComponentsWithStats(stands.astype(np.uint8), connectivity=8)
    rows, cols = label.shape
    margin = SOFT_CELLS
    boxes = [
        (
            slice(max(top - margin, 0), min(top + height + margin, rows)),
            slice(max(left - margin, 0), min(left + width + margin, cols)),
        )
        for left, top, width, height, _ in stats[1:].tolist()
    ]
    return np.asarray(label, np.int32), boxes


def own_whole(
    owner: NDArray[np.int32], surface: Surface, canvas: MosaicGrid, views: Sequence[MosaicView], weigh: Weigh
) -> NDArray[np.int32]:
    """Return the owners (rows, cols) of cells, where each structure and the cells beside it have one owner.

    That is the picture that sees the structure best, of those that see all of it. Where none does, the owners
    remain, and so they do in cells beside it that the picture does not show. Owners are softened over
    ``SOFT_CELLS``: with as many cells beside it, its corners keep their owner too.
    """
    bounds_m = np.array([view.bounds_m for view in views]).reshape(-1, 4)
    sides = np.sqrt(np.prod(bounds_m[:, 2:] - bounds_m[:, :2], axis=1))
    # Half of a picture: a larger structure is rarely in one picture as a whole.
    label, boxes = structures(surface, canvas, float(np.median(sides)) / 2)
    owner, near = owner.copy(), np.ones((2 * SOFT_CELLS + 1,) * 2, np.uint8)
    for k, box in enumerate(boxes, start=1):
        own = label[box] == k
        beside = cv2.dilate(own.astype(np.uint8), near).astype(bool) & (label[box] == 0)
        around = owner[box][own | beside]
        if (around == around[0]).all():
            continue
        (rows, cols), (top, left) = own.shape, (CELL_PX * side.start for side in box)
        lattice = canvas.lattice(top, left, rows, cols, CELL_PX)
        best, best_weight = -1, np.zeros(own.shape, np.float32)
        for index in np.flatnonzero(_may_show(bounds_m, lattice)).tolist():
            weight = weigh(views[index], lattice)
            if (weight[own] > 0).all() and weight[own].sum() > best_weight[own].sum():
                best, best_weight = index, weight
        if best >= 0:
            owner[box][own | (beside & (best_weight > 0))] = best
    return owner


def _over_plane(height_m: Float32) -> Float32:
    """Return heights (rows, cols) over their plane, as an opening cuts the upper end of a slope at the border
    of the map. What is beyond the surface is infinite, and no ground to an opening."""
    r, c = np.nonzero(np.isfinite(height_m))
    out = np.full(height_m.shape, np.inf, np.float32)
    if len(r):
        columns = np.column_stack([r, c, np.ones(len(r))])
        plane = np.linalg.lstsq(columns, height_m[r, c].astype(float), rcond=None)[0]
        out[r, c] = height_m[r, c] - columns @ plane
    return out


def _may_show(bounds_m: Array, lattice: Lattice) -> Mask:
    """Return which pictures may show the middle of a lattice (n,), by the bounds of their ground (n, 4)."""
    x = lattice.x0_m + lattice.step_m * (lattice.cols - 1) / 2
    y = lattice.y0_m - lattice.step_m * (lattice.rows - 1) / 2
    west, south, east, north = bounds_m.T
    return np.asarray((west <= x) & (x <= east) & (south <= y) & (y <= north))
