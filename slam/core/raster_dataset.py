"""The rasters of a map as a dataset of xarray, for notebooks."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError

Array = NDArray[np.float64]

MOST_CELLS = 4_000_000
"""Cells of a dataset without a stated size: its variables then take less than 100 MB."""
_BANDS = ("red", "green", "blue", "alpha")
_VALUES = {
    "sigma": ("mosaic_quality.tif", 2, "standard deviation of the ground's position"),
    "elevation": ("elevation.tif", 1, "height of the ground over the floor"),
    "elevation_sigma": ("elevation.tif", 2, "standard deviation of that height"),
}
"""Variable -> its file, its band and its meaning. An elevation of the sonar alone has one band."""


def raster_dataset(folder: Path, unit: str, cell_m: float | None = None) -> Any:
    """Return an ``xarray.Dataset`` of the rasters in an output folder, over x and y of the world.

    Variables: ``mosaic`` (y, x, band), colours and alpha as bytes; ``sigma``, ``elevation`` and
    ``elevation_sigma`` (y, x), NaN where not known. All have the cells of the mosaic, or larger ones of
    ``cell_m``. Colours are means over a cell, values those at its centre. ``x`` and ``y`` are the centres of
    the cells in ``unit``, y from north to south. The attribute ``crs`` and the coordinate ``spatial_ref`` of
    the CF conventions hold the coordinate system, which a map without a place on Earth in metres has too.

    Raises ``InputError`` without xarray, without a raster, and for a cell that is not above 0.
    """
    try:
        xarray = import_module("xarray")
    except ImportError:
        raise InputError(
            "a dataset of rasters needs xarray: install it with pip install 'lemniscate-slam[data]'"
        ) from None
    if cell_m is not None and not 0 < cell_m < math.inf:
        raise InputError(f"cell_m is {cell_m}; give a length above 0, or leave it out")
    names = [name for name in ("mosaic.tif", "elevation.tif") if (folder / name).is_file()]
    if not names:
        raise InputError(f"{folder}: holds no mosaic and no elevation; map the flight without --no-mosaic")
    colours, x, y, crs = _base(folder / names[0], cell_m)
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"x": ("x", x, _axis("x", unit)), "y": ("y", y, _axis("y", unit))}
    mapped = {}
    if crs:
        coordinates["spatial_ref"] = ((), 0, {"crs_wkt": crs, "spatial_ref": crs})
        mapped = {"grid_mapping": "spatial_ref"}
    if names[0] == "mosaic.tif":
        coordinates["band"] = ("band", list(_BANDS))
        about = {"long_name": "mosaic", **mapped}
        variables["mosaic"] = (("y", "x", "band"), np.moveaxis(colours, 0, 2), about)
    for name, (file, band, meaning) in _VALUES.items():
        values = _at(folder / file, band, x, y)
        if values is not None:
            variables[name] = (("y", "x"), values, {"long_name": meaning, "units": unit, **mapped})
    return xarray.Dataset(variables, coordinates, {"crs": crs} if crs else {})


def _base(path: Path, cell_m: float | None) -> tuple[NDArray[Any], Array, Array, str]:
    """Return the bands (b, rows, cols) of a raster in its own cells or larger ones, their centres and its
    coordinate system."""
    rasterio = import_module("rasterio")
    with rasterio.open(path) as raster:
        least = math.sqrt(raster.width * raster.height / MOST_CELLS) * raster.transform.a
        step = max(1.0, (least if cell_m is None else cell_m) / raster.transform.a)
        shape = max(1, round(raster.height / step)), max(1, round(raster.width / step))
        average = rasterio.enums.Resampling.average
        bands = raster.read(out_shape=(raster.count, *shape), resampling=average)
        west, south, east, north = raster.bounds
        crs = raster.crs.to_wkt() if raster.crs else ""
    x = west + (east - west) * (np.arange(shape[1]) + 0.5) / shape[1]
    y = north - (north - south) * (np.arange(shape[0]) + 0.5) / shape[0]
    return bands, x, y, crs


def _at(path: Path, band: int, x: Array, y: Array) -> NDArray[np.float32] | None:
    """Return the values (rows, cols) of a band at the crossings of x and y; None without such a band."""
    rasterio = import_module("rasterio")
    if not path.is_file():
        return None
    with rasterio.open(path) as raster:
        if raster.count < band:
            return None
        values, at = raster.read(band), raster.transform
    cols, rows = np.floor((x - at.c) / at.a).astype(int), np.floor((y - at.f) / at.e).astype(int)
    in_x, in_y = (cols >= 0) & (cols < values.shape[1]), (rows >= 0) & (rows < values.shape[0])
    found = np.full((len(y), len(x)), np.nan, np.float32)
    found[np.ix_(in_y, in_x)] = values[np.ix_(rows[in_y], cols[in_x])]
    return found


def _axis(name: str, unit: str) -> dict[str, str]:
    return {"units": unit, "axis": name.upper(), "standard_name": f"projection_{name}_coordinate"}
