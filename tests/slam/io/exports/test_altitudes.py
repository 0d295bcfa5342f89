"""Altitudes of the ground, read back by rasterio, against the geometry of the Earth."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.exports import geotiff
from slam.io.exports.formats import export_map
from slam.io.geotiff import Grid, write_bands
from tests.slam.io.exports.made_map import exported, made_map, pose

EARTH_M = 6_371_000.0
STEP_M = 100.0


def altitudes(tmp_path, system, crs="utm", floor_z_m=-28.0):
    """Write the export of a map 8 km wide with heights that rise to the north, and return its folder."""
    heights = np.repeat(np.arange(60, 0, -1, dtype=np.float32)[:, None], 80, axis=1)
    heights[0, 0] = np.nan
    origin = GeoOrigin(47.4, 8.54, 430.0, height_system=system)
    (tmp_path / "map").mkdir()
    grid = Grid(-40 * STEP_M, 30 * STEP_M, STEP_M, 80, 60, origin)
    write_bands(tmp_path / "map" / "elevation.tif", grid, {"height": heights})
    estimate = made_map(pose(), origin=origin, floor_z_m=floor_z_m)
    export_map(exported(estimate, folder=tmp_path / "map", crs=crs), "geotiff", tmp_path / "out")
    return tmp_path / "out"


@pytest.mark.parametrize("system", ["EPSG:5773", "EPSG:4979", "EPSG:5705", "EPSG:6360"])
def test_a_raster_has_altitudes_and_names_their_system(tmp_path, system):
    out = altitudes(tmp_path, system)
    with rasterio.open(out / "altitude.tif") as raster, rasterio.open(out / "elevation.tif") as own:
        wkt = raster.crs.to_wkt(version="WKT2_2019")
        # GeoTIFF has no projection with heights over its ellipsoid: the tag alone says it.
        assert (f'ID["EPSG",{system.removeprefix("EPSG:")}]' in wkt) == (system != "EPSG:4979")
        assert "WGS 84 / UTM zone 32N" in wkt
        assert raster.descriptions == ("altitude",)
        assert raster.tags()["VERTICAL_CRS"] == system
        unit_m = 1200 / 3937 if system == "EPSG:6360" else 1.0
        values, heights = raster.read(1) * unit_m, own.read(1)
        rows, cols = np.nonzero(np.isfinite(heights))
        e, n = (np.array(each) for each in raster.xy(rows, cols))
    np.testing.assert_array_equal(np.isfinite(values), np.isfinite(heights))
    (east_m,), (north_m,) = transform("EPSG:4326", "EPSG:32632", [8.54], [47.4])
    away_m = np.hypot(e - east_m, n - north_m)
    expected = 430.0 - 28.0 + heights[rows, cols] + away_m**2 / (2 * EARTH_M)
    # A value is that of the nearest cell, half a diagonal away at most.
    slack = away_m.max() * STEP_M / EARTH_M + 1e-3
    np.testing.assert_allclose(values[rows, cols], expected, rtol=0, atol=slack)
    assert (away_m**2 / (2 * EARTH_M)).max() > 10 * slack


def test_there_are_no_altitudes_where_nobody_states_their_level(tmp_path):
    out = altitudes(tmp_path, "")
    assert {path.name for path in out.iterdir()} == {"elevation.tif"}


def test_altitudes_are_written_in_degrees_too(tmp_path):
    out = altitudes(tmp_path, "EPSG:4979", crs="EPSG:4326")
    with rasterio.open(out / "altitude.tif") as raster:
        assert raster.crs.to_epsg() == 4979


@pytest.mark.parametrize(
    ("system", "level"),
    [("EPSG:4979", "m over the WGS 84 ellipsoid"), ("", "m in the reference of the recorded")],
)
def test_the_level_of_the_floor_is_told_in_plain_words(tmp_path, system, level):
    bands = {"height": np.zeros((60, 80), np.float32)}
    origin = GeoOrigin(47.4, 8.54, 430.0, height_system=system)
    write_bands(tmp_path / "elevation.tif", Grid(-40, 30, 1.0, 80, 60, origin), bands)
    of = exported(made_map(pose(), origin=origin), folder=tmp_path)
    *_, heights = export_map(of, "geotiff", tmp_path / "out")
    assert f"heights are over the map's floor, at 430.00 {level}" in heights


def test_altitudes_that_cannot_be_written_are_refused_in_one_line(tmp_path, monkeypatch):
    def full(*arguments):
        raise rasterio.errors.RasterioIOError("write failed")

    monkeypatch.setattr(geotiff, "write_altitudes", full)
    with pytest.raises(InputError, match=r"altitude\.tif cannot be brought into it \(write failed\)"):
        altitudes(tmp_path, "EPSG:4979")
