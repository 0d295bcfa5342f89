"""Files of the mosaic's quality: three bands as a GeoTIFF, and a picture of them for a person."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.quality import MosaicQuality, mosaic_quality
from slam.core.estimate import Estimate
from slam.core.plot_style import UNMEASURED, ground_labels, png
from slam.core.units import unit
from slam.io.atomic import write_whole
from slam.io.geotiff import Grid, height_tags, write_bands

_POSITION_BAND = 2
"""Band of the position's standard deviation, counted from 1."""


def write_quality(plan: MosaicPlan, exposure: Exposure, estimate: Estimate, path: Path) -> None:
    """Write ``path`` (.tif) and the picture beside it (.png).

    Raises ``InputError`` where the disk refuses.
    """
    quality = mosaic_quality(
        plan, exposure, estimate.over_floor_T_b, estimate.over_floor_covariances, estimate.floor_z_m
    )
    rows, cols = quality.pictures.shape
    corner = plan.west_m, plan.north_m
    grid = Grid(*corner, quality.cell_m, cols, rows, estimate.origin, estimate.metric)
    bands = {
        "pictures that see it": quality.pictures,
        f"position, standard deviation [{unit(estimate.metric)}]": quality.position_std_m,
        "seam: brightness difference of two pictures, share": quality.seam_share,
    }
    write_bands(path, grid, bands, height_tags(estimate))
    write_whole(path.with_suffix(".png"), quality_picture(quality, grid, estimate.metric))


class GroundAccuracy(NamedTuple):
    """Accuracy of the ground on a mosaic; NaN where it is not known."""

    typical_std_m: float
    """Median over the ground of the standard deviation of a position."""
    worst_std_m: float
    x_m: float
    y_m: float
    """Ground with the largest standard deviation."""


def ground_accuracy(path: Path) -> GroundAccuracy:
    """Return the accuracy of the ground by a file of `write_quality`."""
    import rasterio

    with rasterio.open(path) as source:
        std_m, at = source.read(_POSITION_BAND), source.transform
    if not np.isfinite(std_m).any():
        return GroundAccuracy(*[float("nan")] * 4)
    row, col = np.unravel_index(int(np.nanargmax(std_m)), std_m.shape)
    x, y = at @ (int(col) + 0.5, int(row) + 0.5)
    return GroundAccuracy(float(np.nanmedian(std_m)), float(std_m[row, col]), float(x), float(y))


def quality_picture(quality: MosaicQuality, grid: Grid, metric: bool = True) -> bytes:
    """Draw the three bands in colour over x and y, as PNG."""
    from matplotlib.figure import Figure

    unit_shown, factor = _readable(quality.position_std_m) if metric else (unit(metric), 1.0)
    panels: tuple[tuple[str, NDArray[np.float32], str], ...] = (
        ("Pictures that see it (grey: none)", quality.pictures, "viridis"),
        (f"Position, one standard deviation [{unit_shown}]", factor * quality.position_std_m, "magma_r"),
        ("Brightness of two pictures differs by [%] (grey: no two)", 100 * quality.seam_share, "magma_r"),
    )
    tall = float(np.clip(4.4 * grid.height / grid.width, 1.8, 8.0))
    figure = Figure(figsize=(14.0, tall + 1.3), dpi=110, layout="constrained")
    x, y = ground_labels(grid.origin is not None, metric)
    for axes, (title, values, colours) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.set_facecolor(UNMEASURED)
        high = float(np.nanpercentile(values, 99)) if np.isfinite(values).any() else 1.0
        drawn = axes.imshow(
            values, cmap=colours, extent=grid.extent_m, vmin=0, vmax=max(high, 1e-9), interpolation="nearest"
        )
        axes.set_title(title, fontsize=10)
        axes.set_xlabel(x)
        figure.colorbar(drawn, ax=axes, fraction=0.046 * grid.height / grid.width, pad=0.03)
    figure.axes[0].set_ylabel(y)
    return png(figure, cropped=True)


def _readable(std_m: NDArray[np.float32]) -> tuple[str, float]:
    typical = float(np.nanmedian(std_m)) if np.isfinite(std_m).any() else 1.0
    return ("mm", 1e3) if typical < 0.01 else ("cm", 1e2) if typical < 1 else ("m", 1.0)
