"""The list of obstacles of a map with a mosaic: those of its measured surface, and the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.wording import counted
from frontend.elevation import Elevation
from frontend.mosaic.surface import HeightSource, Surface
from frontend.obstacles import ObstacleList, standing_on
from slam.core.estimate import Estimate
from slam.core.messages import Message, about, joined
from slam.core.units import length, unit
from slam.report.rasters.surface import MeasuredGround

_HEIGHT_SIGMAS = 5.0
"""Standard deviations of measured heights within which none stands out, as of echoes (`Echoes.gamma_m`)."""
_INSTRUMENTS = {"pictures": HeightSource.PICTURES, "sonar": HeightSource.SONAR}


def with_all_obstacles(estimate: Estimate, ground: MeasuredGround | None) -> Estimate:
    """Return the estimate with those of its measured surface in the list, and a note about the list."""
    found = estimate.obstacles
    if found is None:
        return estimate
    if ground is not None and ground.surface is not None:
        found = _of_surface(ground, ground.surface, found.above_m, estimate.floor_slope_rad).joined(found)
    messages = joined(*estimate.messages, *([_note(found, estimate.metric)] if found.by_pictures else []))
    return replace(estimate, obstacles=found, messages=messages)


def _of_surface(
    ground: MeasuredGround, surface: Surface, above_m: float, floor_slope_rad: tuple[float, float]
) -> ObstacleList:
    height_m = surface.height_m if ground.over_plane is None else _over_plane(surface, floor_slope_rad)
    believed = np.where(surface.measured & ~ground.pits, height_m, np.float32(np.nan))
    elevation = Elevation(surface.west_m, surface.north_m, surface.cell_m, believed)
    above_m = max(above_m, _HEIGHT_SIGMAS * (ground.facts.height_std_m or 0.0))
    return standing_on(elevation, above_m, {name: surface.source == of for name, of in _INSTRUMENTS.items()})


def _over_plane(surface: Surface, floor_slope_rad: tuple[float, float]) -> NDArray[np.float32]:
    """Return the heights (rows, cols) of a surface in the level world over the plane of its ground."""
    w_R_f = Rotation.from_rotvec([*floor_slope_rad, 0.0]).as_matrix()
    to_east, to_north = np.linalg.solve(w_R_f[:2, :2].T, w_R_f[2, :2])
    rows, cols = surface.height_m.shape
    x = surface.west_m + (np.arange(cols) + 0.5) * surface.cell_m
    y = surface.north_m - (np.arange(rows) + 0.5) * surface.cell_m
    return np.asarray(surface.height_m - (to_east * x + to_north * y[:, None]), np.float32)


def _note(found: ObstacleList, metric: bool) -> Message:
    """Return what the pictures show, in one line; echoes have one of their own (`slam.mapping.obstacles`)."""
    shown = found.by_pictures
    largest, highest = shown[0], max(shown, key=lambda one: one.height_m)
    return about(
        "obstacles",
        f"the pictures show {counted(len(shown), 'thing that stands', 'things that stand')} higher than "
        f"{length(found.above_m, metric)} on the ground, the highest {length(highest.height_m, metric)}, "
        f"the largest around x = {largest.x_m:.1f}, y = {largest.y_m:.1f} {unit(metric)} (all of them: "
        "obstacles in summary.json)",
        "they keep heights of their own, and bend no map",
    ).as_note()
