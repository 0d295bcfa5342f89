"""The ground of a map that slopes, turned from its plane into the level world.

The pictures of a map are compared over the plane that fits the ground best. A GeoTIFF has the places of the
world, where 10 m up a slope of 30 degrees are 8.7 m, and the height of a place contains that of the plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.surface import HeightSource, Surface
from slam.core.estimate import Estimate
from slam.report.rasters.pits import doubted_pits
from slam.report.rasters.surface import MeasuredGround, OverPlane, height_stds

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

_PLANE_CELLS = 512
"""Most cells of a plane along a side: heights between them are exact."""
_MOST_STEPS = 400
"""Most heights at which the ground is looked for above a place. With more, a step crosses several cells, and
the search takes longer than the mosaic."""


def is_level(estimate: Estimate, plan: MosaicPlan, ground: MeasuredGround) -> bool:
    """Return whether the plane of the ground is as good as the level world.

    Measured heights may differ by a cell. Flat ground has none, so only its places count, to a pixel.
    """
    slope_rad = float(np.linalg.norm(estimate.floor_slope_rad))
    away_m = _farthest_m(plan)
    if ground.surface is None:
        return bool(away_m * (1.0 - np.cos(slope_rad)) < plan.gsd_m)
    return bool(away_m * np.sin(slope_rad) < ground.surface.cell_m)


def levelled(ground: MeasuredGround, plan: MosaicPlan, estimate: Estimate) -> MeasuredGround:
    """Return the ground of a plan over the plane, with its surface in the level world.

    Where the ground was found flat, the surface is the plane. Each height is the highest above its place.
    """
    w_R_f, plane = _w_R_f(estimate), ground.surface or _flat(plan)
    bounds_m = level_bounds(plan, estimate)
    lattice = _Lattice.over(bounds_m, plane.cell_m)
    height_m, cell = lattice.heights(plane, w_R_f)
    pits = doubted_pits(plane)

    def taken(values: NDArray[Any], beyond: Any) -> NDArray[Any]:
        return np.where(cell >= 0, values.ravel()[cell], beyond)

    # An error across the plane is a larger one along the vertical.
    std_m, height_std_m = (
        taken(each / w_R_f[2, 2], np.nan).astype(np.float32)
        for each in (plane.std_m, height_stds(plane, pits))
    )
    source = taken(plane.source, HeightSource.LEVEL).astype(np.uint8)
    surface = Surface(lattice.west_m, lattice.north_m, plane.cell_m, height_m, std_m, source)
    return replace(ground, surface=surface, over_plane=OverPlane(taken(pits, False), height_std_m, bounds_m))


def level_bounds(plan: MosaicPlan, estimate: Estimate) -> dict[int, Array]:
    """Return the bounds (4,) in the level world of the ground in each picture, by the number of its pose."""
    w_R_f = _w_R_f(estimate)
    views = plan.all_views(estimate.over_floor_T_b)
    boxes = {view.k: _box(view.bounds_m) @ w_R_f[:2, :2].T for view in views}
    return {k: np.concatenate([box.min(axis=0), box.max(axis=0)]) for k, box in boxes.items()}


def _w_R_f(estimate: Estimate) -> Array:
    """Return the rotation (3, 3) from the plane of the ground to the level world."""
    return np.asarray(Rotation.from_rotvec([*estimate.floor_slope_rad, 0.0]).as_matrix())


def _box(bounds_m: Array) -> Array:
    """Return the corners (4, 2) of bounds (4,)."""
    west, south, east, north = bounds_m
    return np.array([(x, y) for x in (west, east) for y in (south, north)])


def _farthest_m(plan: MosaicPlan) -> float:
    """Return the distance of the farthest corner of a plan from the origin."""
    east_m, south_m = plan.west_m + plan.width * plan.gsd_m, plan.north_m - plan.height * plan.gsd_m
    corners = _box(np.array([plan.west_m, south_m, east_m, plan.north_m]))
    return float(np.linalg.norm(corners, axis=1).max())


def _flat(plan: MosaicPlan) -> Surface:
    """Return the plane below a plan as a surface."""
    width_m, height_m = plan.width * plan.gsd_m, plan.height * plan.gsd_m
    cell_m = max(plan.gsd_m, max(width_m, height_m) / _PLANE_CELLS)
    shape = int(np.ceil(height_m / cell_m)), int(np.ceil(width_m / cell_m))
    source = np.full(shape, HeightSource.FLOOR, np.uint8)
    level, unknown = np.zeros(shape, np.float32), np.full(shape, np.nan, np.float32)
    return Surface(plan.west_m, plan.north_m, cell_m, level, unknown, source)


@dataclass(frozen=True)
class _Lattice:
    """Cells in the level world."""

    west_m: float
    north_m: float
    cell_m: float
    rows: int
    cols: int

    @staticmethod
    def over(bounds_m: Mapping[int, Array], cell_m: float) -> _Lattice:
        """Return the cells that hold the ground in all pictures."""
        bounds = np.array(list(bounds_m.values()))
        (west, south), (east, north) = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        # One more cell on each side, so that heights are interpolated up to the border.
        rows, cols = (int(np.ceil(side / cell_m)) + 2 for side in (north - south, east - west))
        return _Lattice(float(west) - cell_m, float(north) + cell_m, cell_m, rows, cols)

    def heights(self, plane: Surface, w_R_f: Array) -> tuple[NDArray[np.float32], Numbers]:
        """Return (rows, cols) heights in the level world, and which cell over the plane each is; -1 beyond.

        The vertical above a place is followed down. A step of it crosses one cell of the plane, unless that
        takes more than ``_MOST_STEPS``: things that are narrower than a step may then be missed.
        """
        x = self.west_m + (np.arange(self.cols) + 0.5) * self.cell_m
        y = self.north_m - (np.arange(self.rows) + 0.5) * self.cell_m
        # Over the plane, the place (x, y, z) is f_p0 + z f_up.
        f_p0 = [(x * row[0])[None] + (y * row[1])[:, None] for row in w_R_f.T]
        f_up = w_R_f[2]
        low, high = float(plane.height_m.min()), float(plane.height_m.max())
        step_m = plane.cell_m * f_up[2] / max(float(np.hypot(*f_up[:2])), 1e-9)
        count = min(int((high - low) / step_m) + 1, _MOST_STEPS)
        cell = np.full((self.rows, self.cols), -1, np.int64)
        ends = np.linspace(high, low, count + 1)
        for above, below in pairwise(ends):
            z = (0.5 * (above + below) - f_p0[2]) / f_up[2]
            found = _cell_at(plane, f_p0[0] + z * f_up[0], f_p0[1] + z * f_up[1])
            reached = (cell < 0) & (found >= 0) & (plane.height_m.ravel()[found] >= below)
            cell[reached] = found[reached]
        height = np.where(cell >= 0, plane.height_m.ravel()[cell], 0.0)
        return ((height - f_p0[2]) / f_up[2]).astype(np.float32), cell


def _cell_at(surface: Surface, x: Array, y: Array) -> Numbers:
    """Return the number of the cell of a surface at each place; -1 beyond it."""
    rows, cols = surface.height_m.shape
    c = np.floor((x - surface.west_m) / surface.cell_m).astype(np.int64)
    r = np.floor((surface.north_m - y) / surface.cell_m).astype(np.int64)
    inside = (c >= 0) & (c < cols) & (r >= 0) & (r < rows)
    return np.where(inside, r * cols + c, -1)
