"""Files of the elevation map: heights as a GeoTIFF, and a picture of them for a person."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.plot_style import UNMEASURED, ground_labels, png
from slam.io.atomic import write_whole
from slam.io.geotiff import Grid, write_bands

LEAST_SPAN_M = 0.1
"""Range of the colours on a flat floor, half of it below the floor, so that noise does not look like
hills."""


def write_elevation(estimate: Estimate, out_dir: Path) -> Path | None:
    """Write ``elevation.tif`` and ``elevation.png``; return None where no sonar measured the ground.

    Raises ``InputError`` where the disk refuses.
    """
    elevation = estimate.elevation
    if elevation is None:
        return None
    rows, cols = elevation.height_m.shape
    corner = elevation.west_m, elevation.north_m
    grid = Grid(*corner, elevation.gsd_m, cols, rows, estimate.origin, estimate.metric)
    write_bands(out_dir / "elevation.tif", grid, {"height over the floor [m]": elevation.height_m})
    path = out_dir / "elevation.png"
    write_whole(path, elevation_picture(elevation.height_m, grid))
    return path


def elevation_picture(height: NDArray[np.float32], grid: Grid) -> bytes:
    """Draw the heights in colour over x and y in metres, as PNG."""
    from matplotlib.figure import Figure

    rows, cols = height.shape
    figure = Figure(
        figsize=(8.0, float(np.clip(7.0 * rows / cols, 2.2, 10.0)) + 1.0), dpi=130, layout="constrained"
    )
    axes = figure.subplots()
    axes.set_facecolor(UNMEASURED)
    low, high = (float(q) for q in np.nanpercentile(height, [0.5, 99.5]))
    low, high = min(low, -LEAST_SPAN_M / 2), max(high, LEAST_SPAN_M / 2)
    drawn = axes.imshow(
        height, cmap="viridis", extent=grid.extent_m, vmin=low, vmax=high, interpolation="nearest"
    )
    x, y = ground_labels(on_earth=grid.origin is not None)
    axes.set(xlabel=x, ylabel=y)
    axes.set_title("Height over the floor, by the sonar (grey: the beam has not been there)", fontsize=10)
    figure.colorbar(drawn, ax=axes, label="m", fraction=0.046 * rows / cols, pad=0.03)
    return png(figure, cropped=True)
