"""Files of the mosaic's quality: three bands as a GeoTIFF, and a picture of them for a person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.exposure import Exposure
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.quality import MosaicQuality, mosaic_quality
from slam.core.estimate import Estimate
from slam.core.plot_style import UNMEASURED, ground_labels, png
from slam.core.units import length_unit, unit
from slam.io.atomic import write_whole
from slam.io.geotiff import Grid, height_tags, write_bands
from slam.report.gaps import Gap

if TYPE_CHECKING:
    from affine import Affine
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

_PICTURES_BAND, _POSITION_BAND, _SEAM_BAND = 1, 2, 3
"""Bands of the number of pictures, of the position's standard deviation and of the difference in brightness,
counted from 1."""


_WIDTH_IN, _LETTERS_PT = 9.0, 10
"""Width of the picture: letters are as large on a page of 18 cm as small print, and larger on a screen."""


def write_quality(
    plan: MosaicPlan,
    exposure: Exposure,
    estimate: Estimate,
    w_T_b: NDArray[np.float64],
    path: Path,
    height_std_m: NDArray[np.float32] | None = None,
) -> None:
    """Write ``path`` (.tif) and the picture beside it (.png).

    ``w_T_b``: poses (n, 4, 4) over the plan. ``height_std_m``: standard deviation of the heights of its
    surface, on its lattice.

    Raises ``InputError`` where the disk refuses.
    """
    of_ground = estimate.ground_covariances
    covariances = estimate.over_floor_covariances if of_ground is None else of_ground
    quality = mosaic_quality(plan, exposure, w_T_b, covariances, height_std_m)
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


class QualityFigures(NamedTuple):
    """Figures of the quality of a mosaic; NaN where it is not known."""

    typical_std_m: float
    """Median over the ground of the standard deviation of a position."""
    worst_std_m: float
    x_m: float
    y_m: float
    """Ground with the largest standard deviation."""
    worst_pictures: int
    """Number of pictures that show it; 0 where none is known."""
    seam_share: float
    """Largest difference in brightness between two pictures of one place, as a share."""
    seam_x_m: float
    seam_y_m: float
    """Ground with the largest difference."""
    seam_typical: float
    """Median difference."""
    covered_share: float
    """Share of the cells that a picture shows."""
    holes: int
    """Number of empty areas that ground surrounds on all sides."""
    hole_area_m2: float
    hole_x_m: float
    hole_y_m: float
    """Middle of the largest hole."""
    gap_area_m2: float
    """Area that no picture shows below stretches of the path without usable pictures."""
    hole_beside_m2: float
    """Area of the holes beside these."""


def quality_figures(path: Path, gaps: Sequence[Gap] = ()) -> QualityFigures:
    """Return the figures of a file of `write_quality`; ``gaps``: stretches without usable pictures."""
    import rasterio
    from scipy.ndimage import binary_fill_holes  # a long import

    with rasterio.open(path) as source:
        pictures, std_m, seam = (source.read(band) for band in (_PICTURES_BAND, _POSITION_BAND, _SEAM_BAND))
        at = source.transform
    shown = np.isfinite(pictures)
    covered = float(np.mean(shown))
    hole = binary_fill_holes(shown) & ~shown
    known = np.isfinite(std_m).any()
    views = int(np.nan_to_num(pictures.ravel()[int(np.nanargmax(std_m))])) if known else 0
    largest = *_largest(std_m, at), views, *_largest(seam, at)
    empty = *_holes(hole, at), *_missing_ground_m2(shown, hole, at, gaps)
    return QualityFigures(_median(std_m), *largest, _median(seam), covered, *empty)


def _missing_ground_m2(
    shown: NDArray[np.bool_], hole: NDArray[np.bool_], at: Affine, gaps: Sequence[Gap]
) -> tuple[float, float]:
    """Return the area that no picture shows below ``gaps``, in strips as wide as a picture, and that of each
    ``hole`` (rows, cols) beside these.

    Ground beyond the raster is missing as well.
    """
    strips = [gap for gap in gaps if gap.shows_nothing and gap.width_m > 0]
    before = (0, 0)
    if strips:  # cells beyond the raster hold the whole strips
        ends = np.array([gap.ends_m for gap in strips]).reshape(-1, 2)
        far_m = max(gap.width_m for gap in strips)
        cells = [~at @ tuple(corner) for corner in (*(ends - far_m), *(ends + far_m))]
        low, high = np.floor(np.min(cells, axis=0)).astype(int), np.ceil(np.max(cells, axis=0)).astype(int)
        before = (max(0, -int(low[1])), max(0, -int(low[0])))
        behind = tuple(max(0, int(end) - size) for end, size in zip(high[::-1], shown.shape, strict=True))
        around = tuple(zip(before, behind, strict=True))
        shown, hole = np.pad(shown, around), np.pad(hole, around)
    row, col = np.nonzero(~shown)
    right, down = col - before[1] + 0.5, row - before[0] + 0.5
    x, y = at.a * right + at.b * down + at.c, at.d * right + at.e * down + at.f
    below = np.zeros(len(row), dtype=bool)
    for gap in strips:
        (x0, y0), (x1, y1) = gap.ends_m
        along = np.array([x1 - x0, y1 - y0]) / max(np.hypot(x1 - x0, y1 - y0), 1e-9)
        ahead, aside = (x - x0) * along[0] + (y - y0) * along[1], (y - y0) * along[0] - (x - x0) * along[1]
        inside = (ahead > 0) & (ahead < np.hypot(x1 - x0, y1 - y0))
        below |= inside & (np.abs(aside) < gap.width_m / 2)
    in_hole = hole[row, col]
    cell_m2 = abs(at.a * at.e)
    return float(np.count_nonzero(below) * cell_m2), float(np.count_nonzero(in_hole & ~below) * cell_m2)


def _holes(hole: NDArray[np.bool_], at: Affine) -> tuple[int, float, float, float]:
    """Return number and area of the holes of (rows, cols), and x and y of the middle of the largest."""
    from scipy.ndimage import center_of_mass, label

    holes, count = label(hole)
    if not count:
        return 0, 0.0, float("nan"), float("nan")
    largest = int(np.argmax(np.bincount(holes.ravel())[1:])) + 1
    row, col = center_of_mass(holes == largest)
    x, y = at @ (float(col) + 0.5, float(row) + 0.5)
    return int(count), float(np.count_nonzero(holes) * abs(at.a * at.e)), float(x), float(y)


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
    from matplotlib.figure import Figure

    unit_shown, factor = _readable(quality.position_std_m) if metric else (unit(metric), 1.0)
    position = factor * quality.position_std_m
    shares = 100 * quality.seam_share
    panels: tuple[tuple[str, NDArray[np.float32], str, Normalize], ...] = (
        ("Pictures that see it\n(grey: none)", quality.pictures, "viridis", _to_largest(quality.pictures)),
        (
            f"Uncertainty of its position\n1σ, x and y together [{unit_shown}]",
            position,
            "magma_r",
            _to_largest(position),
        ),
        (
            "Brightness of two pictures\ndiffers by [%] (grey: no two)",
            shares,
            "magma_r",
            _to_largest(shares),
        ),
    )
    tall = float(np.clip(0.3 * _WIDTH_IN * grid.height / grid.width, 1.4, 0.6 * _WIDTH_IN))
    figure = Figure(figsize=(_WIDTH_IN, tall + 1.2), dpi=160, layout="constrained")
    x, y = ground_labels(grid.origin is not None, metric)
    first, *others = figure.subplots(1, 3)
    for axes, (title, values, colours, norm) in zip((first, *others), panels, strict=True):
        axes.set_facecolor(UNMEASURED)
        drawn = axes.imshow(values, cmap=colours, extent=grid.extent_m, norm=norm, interpolation="nearest")
        axes.set_title(title, fontsize=_LETTERS_PT)
        axes.set_xlabel(x, fontsize=_LETTERS_PT)
        if axes is not first:
            _ring_largest(axes, values, grid)
        bar = figure.colorbar(drawn, ax=axes, fraction=0.046 * grid.height / grid.width, pad=0.03)
        for each in (axes, bar.ax):
            each.tick_params(labelsize=_LETTERS_PT - 1)
        axes.locator_params(nbins=5)
    first.set_ylabel(y, fontsize=_LETTERS_PT)
    return figure


def _ring_largest(axes: Axes, values: NDArray[np.float32], grid: Grid) -> None:
    """Draw a ring, dark with a white border, around the largest value, whose place the report tells."""
    found, x, y = _largest(values, grid.affine)
    if np.isfinite(found):
        axes.autoscale(False)
        for width, colour in (3.5, "white"), (1.5, "black"):
            axes.plot(x, y, "o", markersize=9, markerfacecolor="none", markeredgecolor=colour,
                      markeredgewidth=width, clip_on=False)  # fmt: skip


def _to_largest(values: NDArray[np.float32]) -> Normalize:
    """Return colours from 0 to the largest value, which is the one that the report states."""
    from matplotlib.colors import Normalize

    high = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
    return Normalize(0, max(high, float(np.finfo(np.float32).tiny)))


def _readable(std_m: NDArray[np.float32]) -> tuple[str, float]:
    """Return the unit in which the largest value is told elsewhere, and its number in a metre."""
    return length_unit(float(np.nanmax(std_m)) if np.isfinite(std_m).any() else 1.0)
