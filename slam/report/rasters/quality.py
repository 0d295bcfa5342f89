"""Files of the mosaic's quality: three bands as a GeoTIFF, and a picture of them for a person."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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

if TYPE_CHECKING:
    from affine import Affine
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

_POSITION_BAND, _SEAM_BAND = 2, 3
"""Bands of the position's standard deviation and of the difference in brightness, counted from 1."""


def write_quality(plan: MosaicPlan, exposure: Exposure, estimate: Estimate, path: Path) -> None:
    """Write ``path`` (.tif) and the picture beside it (.png).

    Raises ``InputError`` where the disk refuses.
    """
    of_ground = estimate.ground_covariances
    covariances = estimate.over_floor_covariances if of_ground is None else of_ground
    quality = mosaic_quality(plan, exposure, estimate.over_floor_T_b, covariances, estimate.floor_z_m)
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
    seam_share: float
    """Largest difference in brightness between two pictures of one place, as a share."""
    seam_x_m: float
    seam_y_m: float
    """Ground with the largest difference."""
    seam_typical: float
    """Median difference."""


def ground_accuracy(path: Path) -> GroundAccuracy:
    """Return the accuracy of the ground by a file of `write_quality`."""
    import rasterio

    with rasterio.open(path) as source:
        std_m, seam, at = source.read(_POSITION_BAND), source.read(_SEAM_BAND), source.transform
    return GroundAccuracy(_median(std_m), *_largest(std_m, at), *_largest(seam, at), _median(seam))


def _median(values: NDArray[np.float32]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def _largest(values: NDArray[np.float32], at: Affine) -> tuple[float, float, float]:
    """Return the largest of the values (rows, cols) and its x and y; NaN where none is known."""
    if not np.isfinite(values).any():
        return (float("nan"),) * 3
    row, col = np.unravel_index(int(np.nanargmax(values)), values.shape)
    x, y = at @ (int(col) + 0.5, int(row) + 0.5)
    return float(values[row, col]), float(x), float(y)


def quality_picture(quality: MosaicQuality, grid: Grid, metric: bool = True) -> bytes:
    """Draw the three bands in colour over x and y, as PNG."""
    return png(quality_figure(quality, grid, metric), cropped=True)


def quality_figure(quality: MosaicQuality, grid: Grid, metric: bool = True) -> Figure:
    """Return the figure with the three bands and their colour bars."""
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    unit_shown, factor = _readable(quality.position_std_m) if metric else (unit(metric), 1.0)
    position = factor * quality.position_std_m
    # A share has the same colours on every page. The root tells small shares apart, which are the rule.
    shares = PowerNorm(0.5, vmin=0, vmax=100, clip=True)
    panels: tuple[tuple[str, NDArray[np.float32], str, Normalize], ...] = (
        ("Pictures that see it (grey: none)", quality.pictures, "viridis", _to_largest(quality.pictures)),
        (f"Position, one standard deviation [{unit_shown}]", position, "magma_r", _to_largest(position)),
        (
            "Brightness of two pictures differs by [%] (grey: no two)",
            100 * quality.seam_share,
            "magma_r",
            shares,
        ),
    )
    tall = float(np.clip(4.4 * grid.height / grid.width, 1.8, 8.0))
    figure = Figure(figsize=(14.0, tall + 1.3), dpi=110, layout="constrained")
    x, y = ground_labels(grid.origin is not None, metric)
    for axes, (title, values, colours, norm) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.set_facecolor(UNMEASURED)
        drawn = axes.imshow(values, cmap=colours, extent=grid.extent_m, norm=norm, interpolation="nearest")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel(x)
        figure.colorbar(drawn, ax=axes, fraction=0.046 * grid.height / grid.width, pad=0.03)
    figure.axes[0].set_ylabel(y)
    return figure


def _to_largest(values: NDArray[np.float32]) -> Normalize:
    """Return colours from 0 to the largest value, which is the one that the report states."""
    from matplotlib.colors import Normalize

    high = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
    return Normalize(0, max(high, float(np.finfo(np.float32).tiny)))


def _readable(std_m: NDArray[np.float32]) -> tuple[str, float]:
    typical = float(np.nanmedian(std_m)) if np.isfinite(std_m).any() else 1.0
    return ("mm", 1e3) if typical < 0.01 else ("cm", 1e2) if typical < 1 else ("m", 1.0)
