"""Files of the elevation map: heights as a GeoTIFF, and a picture of them for a person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from frontend.elevation import Elevation
from frontend.mosaic.surface import HeightSource, Surface
from slam.core.estimate import Estimate
from slam.core.plot_style import UNMEASURED, ground_labels, png
from slam.core.units import unit
from slam.io.atomic import write_whole
from slam.io.geotiff import Grid, height_tags, write_bands
from slam.report.floor_scatter import LEAST_SPAN_M, floor_scatter
from slam.report.rasters.surface import MeasuredGround

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT_BAND = "height over the floor [m]"
_VEIL = 0.55
"""Share of white over heights that were not measured: pale, and their colour can still be told."""
_WIDTH_IN = 6.2
"""Width of the picture: letters of 10 points are as large on a page as its text."""
_BEYOND: Mapping[tuple[bool, bool], Literal["neither", "min", "max", "both"]] = {
    (False, False): "neither",
    (True, False): "min",
    (False, True): "max",
    (True, True): "both",
}
"""Whether heights lie below and above the range of the colours -> the ends of their bar that are pointed."""
_SHOWN = (0.5, 99.5)
"""Percentiles of heights at the ends of the colours: a few of many are wrong. Over a flat floor, on which a
thing may be a few cells of echoes, the colours span all of them."""


def write_elevation(estimate: Estimate, out_dir: Path, ground: MeasuredGround | None = None) -> Path | None:
    """Write ``elevation.tif`` and ``elevation.png``; return None where nothing measured the ground.

    With a measured surface, that is the first band, and the sonar's heights are a further one.

    Raises ``InputError`` where the disk refuses.
    """
    elevation = estimate.elevation
    doubts, surface = None, ground.surface if ground is not None else None
    if ground is not None and surface is not None:
        corner, cell_m, shape = (surface.west_m, surface.north_m), surface.cell_m, surface.height_m.shape
        # The sonar's heights are those over the plane of a slope.
        bands = _surface_bands(surface, ground.pits, elevation if ground.over_plane is None else None)
        doubts = {
            "filled in": surface.source == HeightSource.FILLED,
            "doubted": ground.pits,
            "taken as level": surface.source == HeightSource.LEVEL,
        }
    elif elevation is not None:
        corner, cell_m, shape = (
            (elevation.west_m, elevation.north_m),
            elevation.gsd_m,
            elevation.height_m.shape,
        )
        bands = {HEIGHT_BAND: elevation.height_m}
    else:
        return None
    grid = Grid(*corner, cell_m, shape[1], shape[0], estimate.origin, estimate.metric)
    write_bands(out_dir / "elevation.tif", grid, bands, height_tags(estimate))
    path = out_dir / "elevation.png"
    write_whole(path, elevation_picture(bands[HEIGHT_BAND], grid, _measured_by(surface), doubts))
    return path


def _measured_by(surface: Surface | None) -> str:
    if surface is None:
        return "the height sensor"
    alone = bool((surface.source == HeightSource.SONAR).any())
    return "the pictures and the height sensor" if alone else "the pictures"


def _surface_bands(
    surface: Surface, pits: NDArray[np.bool_], elevation: Elevation | None
) -> dict[str, NDArray[np.float32]]:
    """Return the surface, its standard deviation, which heights in ``pits`` have none of, the sources of its
    heights, and the sonar's heights."""
    sources = ", ".join(f"{source.value} {source.name.lower()}" for source in HeightSource)
    bands = {
        HEIGHT_BAND: np.where(surface.source == HeightSource.UNSEEN, np.float32(np.nan), surface.height_m),
        "height, standard deviation [m]": np.where(pits, np.float32(np.nan), surface.std_m),
        f"source of the height: {sources}": surface.source.astype(np.float32),
    }
    if elevation is not None:
        rows, cols = surface.height_m.shape
        x = surface.west_m + (np.arange(cols) + 0.5) * surface.cell_m
        y = surface.north_m - (np.arange(rows) + 0.5) * surface.cell_m
        bands["height over the floor by the sonar [m]"] = elevation.at(*np.meshgrid(x, y))
    return bands


def elevation_picture(
    height: NDArray[np.float32],
    grid: Grid,
    by: str = "the height sensor",
    doubts: Mapping[str, NDArray[np.bool_]] | None = None,
) -> bytes:
    """Draw the heights in colour over x and y in metres, as PNG; ``by`` says what measured them.

    Heights with a doubt are paler: its word -> where it is. None is for heights by echoes alone.
    """
    from matplotlib.figure import Figure

    rows, cols = height.shape
    figure = Figure(
        figsize=(_WIDTH_IN, float(np.clip(0.87 * _WIDTH_IN * rows / cols, 2.0, 1.25 * _WIDTH_IN)) + 1.0),
        dpi=170,
        layout="constrained",
    )
    axes = figure.subplots()
    axes.set_facecolor(UNMEASURED)
    floor = None if doubts is not None else floor_scatter(height)
    low, high = (float(q) for q in np.nanpercentile(height, _SHOWN if floor is None else (0, 100)))
    low, high = min(low, -LEAST_SPAN_M / 2), max(high, LEAST_SPAN_M / 2)
    shown = height
    if floor is not None:
        in_floor = (height >= floor.lowest_m) & (height <= floor.highest_m)
        shown = np.where(in_floor, floor.middle_m, height)
    drawn = axes.imshow(
        shown, cmap="viridis", extent=grid.extent_m, vmin=low, vmax=high, interpolation="nearest"
    )
    grey = "not measured"
    if doubts is not None:
        grey, known = "no picture", np.isfinite(height)
        if some := [word for word, where in doubts.items() if (where & known).any()]:
            _veil(axes, np.any([where & known for where in doubts.values()], axis=0), grid)
            grey = f"no picture; pale: {' or '.join(some)}"
    if floor is not None:
        grey = f"{grey}; floor in one colour: {floor}"
    x, y = ground_labels(grid.origin is not None, grid.metric)
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(f"Height over the floor, by {by}\n(grey: {grey})", fontsize=10)
    further = _BEYOND[bool(np.nanmin(height) < low), bool(np.nanmax(height) > high)]
    figure.colorbar(
        drawn, ax=axes, label=f"height [{unit(grid.metric)}]", fraction=0.046 * rows / cols, pad=0.03,
        extend=further,
    )  # fmt: skip
    return png(figure, cropped=True)


def _veil(axes: Axes, where: NDArray[np.bool_], grid: Grid) -> None:
    veil = np.zeros((*where.shape, 4), np.float32)
    veil[where] = 1.0, 1.0, 1.0, _VEIL
    axes.imshow(veil, extent=grid.extent_m, interpolation="nearest")
