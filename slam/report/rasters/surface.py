"""Ground under a mosaic: how well its pictures agree over the floor, and the surface where they do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from frontend.elevation import Elevation
from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.build import build_surface
from frontend.surface.disagreement import Disagreement, disagreement
from frontend.surface.misregistration import Misregistration, measure_misregistration, seen_by_two
from frontend.surface.relief import is_better, relief_squares
from slam.core.estimate import GroundFacts
from slam.core.progress import Progress
from slam.report.rasters.pits import doubted_pits, lowest_place

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
PERCENTS = (50, 95)
"""Percentiles of the misregistration that are reported."""


@dataclass(frozen=True)
class OverPlane:
    """Findings over the plane of a slope, on the lattice of a surface in the level world."""

    pits: Mask
    """(rows, cols) measured heights that are doubted."""
    height_std_m: Float32
    """(rows, cols) standard deviation of the heights; NaN beyond the plane."""
    bounds_m: Mapping[int, Array]
    """Pose number -> bounds (4,) in the level world of the ground in its picture."""


@dataclass(frozen=True)
class MeasuredGround:
    """The ground of a mosaic, and how well its pictures agree on it."""

    over_floor: Misregistration
    surface: Surface | None
    """None where nothing shows that the ground is not flat."""
    over_surface: Misregistration | None = None
    over_plane: OverPlane | None = None
    """None where the plane of the ground is level."""
    disagreement: Disagreement = field(default_factory=Disagreement)
    """Ground on which no two pictures agree, over the surface or else the floor."""

    @cached_property
    def pits(self) -> Mask:
        """(rows, cols) measured heights of the surface that are doubted."""
        assert self.surface is not None
        if self.over_plane is not None:
            return self.over_plane.pits & self.surface.measured
        return doubted_pits(self.surface)

    @cached_property
    def height_std_m(self) -> Float32 | None:
        """(rows, cols) standard deviation of the heights of the surface; None without one."""
        if self.over_plane is not None:
            return self.over_plane.height_std_m
        return None if self.surface is None else height_stds(self.surface, self.pits)

    @cached_property
    def facts(self) -> GroundFacts:
        """The figures for the summary."""
        after = self.over_surface or self.over_floor
        before_px, after_px = (
            tuple(m.percentile_px(percent) for percent in PERCENTS) for m in (self.over_floor, after)
        )
        flat = GroundFacts(
            misregistration_px=after_px,
            over_floor_px=before_px,
            unmatched_share=self.disagreement.share,
            unmatched_at_m=self.disagreement.at_m,
        )
        if self.surface is None:
            return flat
        shown = self.surface.source != HeightSource.UNSEEN
        source, height, std = (
            of_cell[shown] for of_cell in (self.surface.source, self.surface.height_m, self.surface.std_m)
        )
        relief = ~self.surface.on_floor[shown]
        if not relief.any():
            return flat
        known, pits = std[relief & np.isfinite(std)], self.pits
        return replace(
            flat,
            relief_share=float(relief.mean()),
            filled_share=float((source == HeightSource.FILLED).sum() / relief.sum()),
            level_share=float((source == HeightSource.LEVEL).mean()),
            lowest_m=float(height.min()),
            highest_m=float(height.max()),
            height_std_m=float(np.median(known)) if len(known) else None,
            doubted_share=float(pits.sum() / max(self.surface.measured.sum(), 1)),
            doubted_at_m=lowest_place(self.surface, pits),
        )


def height_stds(surface: Surface, pits: Mask) -> Float32:
    """Return (rows, cols) the standard deviation of each height in metres.

    Where nothing measured it, or where it is one of the doubted ``pits``, it is the root mean square of the
    measured ones over the floor: such ground may be as uneven as the rest (NaN where nothing was measured at
    all). Ground that was found flat is exact.
    """
    believed = surface.measured & ~pits
    known = believed & np.isfinite(surface.std_m)
    usual_m = float(np.median(surface.std_m[known])) if known.any() else 0.0  # the sonar's have none
    spread_m = np.sqrt(np.mean(surface.height_m[believed] ** 2, dtype=float)) if believed.any() else np.nan
    std_m = np.where(surface.source == HeightSource.FLOOR, 0.0, spread_m)
    std_m[believed] = usual_m
    std_m[known] = surface.std_m[known]
    return std_m.astype(np.float32)


def without_unseen(surface: Surface, plan: MosaicPlan) -> Surface:
    """Return the surface with the cells that no picture of a plan shows marked as unseen.

    Their heights remain: ground that is seen interpolates towards them.
    """
    rows, cols = surface.height_m.shape
    cell_m = CELL_PX * plan.gsd_m
    r = (plan.north_m - surface.north_m + (np.arange(rows) + 0.5) * surface.cell_m) // cell_m
    c = (surface.west_m - plan.west_m + (np.arange(cols) + 0.5) * surface.cell_m) // cell_m
    inside = (r >= 0) & (r < plan.owner.shape[0]), (c >= 0) & (c < plan.owner.shape[1])
    source = np.full_like(surface.source, HeightSource.UNSEEN)
    of_plan = plan.owner[np.ix_(r[inside[0]].astype(int), c[inside[1]].astype(int))]
    known = np.ix_(*inside)
    source[known] = np.where(of_plan >= 0, surface.source[known], HeightSource.UNSEEN)
    return replace(surface, source=source)


def measure_ground(
    plan: MosaicPlan, pictures: Pictures, w_T_b: Array,
    elevation: Elevation | None, progress: Progress,
) -> MeasuredGround:  # fmt: skip
    """Compare the pictures of a mosaic over the floor, and measure the surface where it is not flat.

    All placed pictures at ``w_T_b`` (n, 4, 4) are matched, also those that the mosaic does not need. The
    surface counts only where it makes the pictures agree better than the floor does.
    """
    over_floor = measure_misregistration(plan, pictures, progress)
    relief = relief_squares(over_floor)
    if not relief.any():
        return MeasuredGround(over_floor, None, disagreement=disagreement(over_floor, plan))
    all_views = replace(plan, views=plan.all_views(w_T_b))
    matched = pictures.over(all_views)
    # Where the mosaic needs one picture alone, others may show the ground as well: none was compared there.
    seen = seen_by_two(all_views)
    relief |= seen & ~over_floor.compared
    surface = build_surface(all_views, matched, relief, elevation, progress, seen)
    over_surface = measure_misregistration(replace(plan, surface=surface), pictures, progress)
    if not is_better(over_surface, over_floor):
        return MeasuredGround(over_floor, None, disagreement=disagreement(over_floor, plan))
    return MeasuredGround(over_floor, surface)
