"""The ground of a map as coloured points, taken from its mosaic and surface model."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import Resampling
from scipy.spatial.transform import Rotation

from slam.core.estimate import Estimate

Array = NDArray[np.float64]

_SURFACE_BANDS = 3
"""A surface model has height, deviation and source; the sonar alone gives one band, over a flat floor."""
_SEEN = 128
"""Least mean alpha of the pixels behind a point: half of them are seen."""


def floor_points(folder: Path, estimate: Estimate, most: int) -> tuple[Array, NDArray[np.uint8]] | None:
    """Return up to ``most`` points (n, 3) of the ground and their colours (n, 3); None without a mosaic."""
    mosaic = folder / "mosaic.tif"
    if not mosaic.is_file():
        return None
    with rasterio.open(mosaic) as raster:
        step = max(1, math.ceil(math.sqrt(raster.width * raster.height / max(most, 1))))
        shape = max(1, raster.height // step), max(1, raster.width // step)
        rgba = raster.read(out_shape=(4, *shape), resampling=Resampling.average)
        # The reduced raster covers the whole one: its cells need not hold a whole number of pixels.
        west, south, east, north = raster.bounds
    rows, cols = np.nonzero(rgba[3] >= _SEEN)
    x = west + (east - west) * (cols + 0.5) / shape[1]
    y = north - (north - south) * (rows + 0.5) / shape[0]
    z = estimate.floor_z_m + _heights(folder / "elevation.tif", x, y)
    return _sloped(np.column_stack([x, y, z]), estimate), rgba[:3, rows, cols].T


def _heights(surface: Path, x: Array, y: Array) -> Array:
    """Return the height of the ground over the floor (n,), 0 where it was not measured."""
    if not surface.is_file():
        return np.zeros(len(x))
    with rasterio.open(surface) as raster:
        if raster.count < _SURFACE_BANDS:
            return np.zeros(len(x))
        heights, at = raster.read(1), raster.transform
    col, row = (np.floor(each).astype(int) for each in ((x - at.c) / at.a, (y - at.f) / at.e))
    inside = (col >= 0) & (row >= 0) & (col < heights.shape[1]) & (row < heights.shape[0])
    found = np.zeros(len(x))
    found[inside] = heights[row[inside], col[inside]]
    return np.nan_to_num(found)


def _sloped(points: Array, estimate: Estimate) -> Array:
    """Return points over a level floor, as rasters are drawn, in the world of the poses."""
    turn = Rotation.from_rotvec([*estimate.floor_slope_rad, 0.0])
    under = np.array([0.0, 0.0, estimate.floor_z_m])
    return np.asarray(turn.apply(points - under) + under)
