"""Rasters of an output folder as a dataset of xarray."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rasterio.crs import CRS

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.estimate import read_estimate, write_estimate
from slam.io.geotiff import Block, Grid, write_bands, write_geotiff
from tests.slam.made_estimate import made_estimate

GRID = Grid(-4.0, 6.0, 0.5, 16, 12, GeoOrigin(52.0, 4.4, 3.0))


def rasters(folder: Path, grid: Grid = GRID) -> Path:
    """A mosaic whose red is its column, and a quality of cells of 1 m whose values are their numbers."""
    folder.mkdir()
    rgba = np.full((grid.height, grid.width, 4), 255, np.uint8)
    rgba[..., 0] = 10 * np.arange(grid.width)
    write_geotiff(folder / "mosaic.tif", grid, iter([Block(0, 0, rgba)]))
    coarse = replace(grid, gsd_m=2 * grid.gsd_m, width=grid.width // 2, height=grid.height // 2)
    numbers = np.arange(coarse.width * coarse.height, dtype=np.float32).reshape(coarse.height, coarse.width)
    write_bands(folder / "mosaic_quality.tif", coarse, {"n": numbers + 100, "std": numbers, "light": numbers})
    return folder


@pytest.fixture
def folder(tmp_path) -> Path:
    return rasters(tmp_path / "map")


def test_all_variables_have_the_cells_of_the_mosaic(folder):
    found = made_estimate().to_xarray(folder)
    assert found.mosaic.dims == ("y", "x", "band")
    assert found.mosaic.dtype == np.uint8
    np.testing.assert_allclose(found.x, np.arange(-3.75, 4.0, 0.5))
    np.testing.assert_allclose(found.y, np.arange(5.75, 0.0, -0.5))
    np.testing.assert_array_equal(found.mosaic.sel(band="red")[0], 10 * np.arange(16))
    # Cell (1, 2) of the quality, eight to a row, is from -2 m to -1 m and from 5 m to 4 m.
    assert float(found.sigma.sel(x=-1.6, y=4.6, method="nearest")) == 10.0
    assert found.sigma.attrs["units"] == found.x.attrs["units"] == "m"
    assert "elevation" not in found


def test_larger_cells_have_mean_colours(folder):
    found = made_estimate().to_xarray(folder, cell_m=1.0)
    np.testing.assert_array_equal(found.mosaic.sel(band="red")[0], 20 * np.arange(8) + 5)
    np.testing.assert_array_equal(found.sigma.values.ravel(), np.arange(48))


def test_the_coordinate_system_is_that_of_the_files(folder, tmp_path):
    found = made_estimate().to_xarray(folder)
    assert CRS.from_wkt(found.attrs["crs"]) == GRID.crs
    assert found.sigma.attrs["grid_mapping"] == "spatial_ref"
    assert CRS.from_wkt(found.spatial_ref.attrs["crs_wkt"]) == GRID.crs
    local = rasters(tmp_path / "local", replace(GRID, origin=None))
    assert "local metres" in made_estimate().to_xarray(local).attrs["crs"]
    unscaled = rasters(tmp_path / "unscaled", replace(GRID, origin=None, metric=False))
    bare = replace(made_estimate(), metric=False).to_xarray(unscaled)
    assert "crs" not in bare.attrs
    assert bare.x.attrs["units"] == "heights"


def test_elevation_is_nan_beyond_its_raster(folder):
    west = replace(GRID, width=8)
    bands = {"height": np.full((12, 8), 2.0, np.float32), "std": np.full((12, 8), 0.1, np.float32)}
    write_bands(folder / "elevation.tif", west, bands)
    found = made_estimate().to_xarray(folder)
    np.testing.assert_array_equal(found.elevation[0], [2.0] * 8 + [np.nan] * 8)
    assert float(found.elevation_sigma.max()) == np.float32(0.1)
    for name in ("mosaic.tif", "mosaic_quality.tif"):
        (folder / name).unlink()
    alone = made_estimate().to_xarray(folder)
    assert set(alone.data_vars) == {"elevation", "elevation_sigma"}
    assert alone.sizes == {"y": 12, "x": 8}


def test_the_folder_that_was_read_is_the_default(folder):
    write_estimate(made_estimate(), folder)
    assert read_estimate(folder).to_xarray().sizes["x"] == 16
    with pytest.raises(InputError, match=r"to_xarray\(folder\)"):
        made_estimate().to_xarray()


def test_what_cannot_be_read_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no mosaic and no elevation"):
        made_estimate().to_xarray(tmp_path)
    for cell_m in (0.0, float("nan")):
        with pytest.raises(InputError, match="give a length above 0"):
            made_estimate().to_xarray(folder, cell_m)


def test_without_the_package_one_line_says_how_to_install_it(folder, monkeypatch):
    real = importlib.import_module

    def refuse(name, *args):
        if name == "xarray":
            raise ImportError(name=name)
        return real(name, *args)

    monkeypatch.setattr("slam.core.raster_dataset.import_module", refuse)
    with pytest.raises(InputError, match=r"pip install 'lemniscate-slam\[data\]'"):
        made_estimate().to_xarray(folder)
