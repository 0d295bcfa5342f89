"""Rasters in a named coordinate system, against the transformation of single points."""

from __future__ import annotations

import errno

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.exports import geotiff
from slam.io.exports.formats import export_map
from slam.io.exports.geotiff import coordinate_system, write_rasters
from slam.io.geotiff import Grid, write_bands
from tests.slam.io.exports.made_map import exported, made_map, pose

ORIGIN = GeoOrigin(40.5, -74.4, 30.0)


@pytest.fixture
def folder(tmp_path):
    """An elevation map of 40 m x 30 m with one cell of 7 m, 12 m east and 8 m south of the origin."""
    heights = np.zeros((60, 80), np.float32)
    heights[36, 64] = 7.0
    out = tmp_path / "map"
    out.mkdir()
    write_bands(out / "elevation.tif", Grid(-20.25, 10.25, 0.5, 80, 60, ORIGIN), {"height": heights})
    return out


def test_a_height_lies_where_its_point_is_transformed_to(folder, tmp_path):
    target = tmp_path / "rasters"
    estimate = made_map(pose(), origin=ORIGIN)
    notes = export_map(exported(estimate, folder=folder), "geotiff", target)
    assert "EPSG:32618" in notes[0]
    with rasterio.open(target / "elevation.tif") as raster:
        assert raster.crs.to_epsg() == 32618
        assert float(raster.tags()["FLOOR_ALTITUDE_M"]) == pytest.approx(30.0 + estimate.floor_z_m)
        values = raster.read(1)
        r, c = np.nonzero(values == 7.0)
        x, y = raster.xy(r.mean(), c.mean())
    with rasterio.open(folder / "elevation.tif") as raster:
        (east,), (north,) = transform(raster.crs, "EPSG:32618", [12.0], [-8.0])
    assert (x, y) == (pytest.approx(east, abs=0.5), pytest.approx(north, abs=0.5))


@pytest.mark.parametrize(
    ("place", "code"),
    [
        ((52.0, 4.3), 32631),
        ((-33.9, 18.4), 32734),
        ((0.0, 180.0), 32601),
        ((10.0, -180.0), 32601),
        ((84.0, 4.3), 32631),
        ((84.1, 4.3), 5041),
        ((-80.1, 4.3), 5042),
    ],
)
def test_the_zone_is_that_of_the_place(place, code):
    assert coordinate_system("utm", GeoOrigin(*place, 0.0)).to_epsg() == code
    assert coordinate_system("EPSG:3857", GeoOrigin(*place, 0.0)).to_epsg() == 3857


@pytest.mark.parametrize("name", ["EPSG:99999", "epsg", "WGS84", "utm18"])
def test_an_unknown_system_is_refused_in_one_line(name):
    with pytest.raises(InputError, match="give utm, or EPSG: and its number") as refused:
        coordinate_system(name, ORIGIN)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("code", [5703, 4978, 5800])
def test_a_system_without_places_on_a_plane_is_refused(code):
    """Heights, geocentric coordinates, and axes of one site without a transformation to others."""
    with pytest.raises(InputError, match="no map can be drawn; give utm") as refused:
        coordinate_system(f"EPSG:{code}", ORIGIN)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("code", "plane"),
    [
        (7415, "Amersfoort / RD New"),
        (4979, "WGS 84 in two dimensions"),
        ("25832+7837", "EPSG:25832, ETRS89 / UTM zone 32N"),
    ],
)
def test_a_system_with_heights_is_refused(code, plane):
    """Heights of rasters count from the floor: no vertical datum is theirs. PROJ takes heights over another
    one for the same where it has no grid of the geoid, so that altitudes are not converted."""
    with pytest.raises(InputError, match="a system with heights") as refused:
        coordinate_system(f"EPSG:{code}", ORIGIN)
    assert plane in str(refused.value)
    assert "gdalwarp" in str(refused.value)


def test_a_projection_that_changes_lengths_is_told(folder, tmp_path):
    estimate = made_map(pose(), origin=ORIGIN)
    notes = {
        code: export_map(exported(estimate, folder=folder, crs=f"EPSG:{code}"), "geotiff", tmp_path / code)
        for code in ("3857", "32618", "2263")
    }
    # Web Mercator: 1 / cos(40.5 deg) on a sphere, by a / N = 0.9986 for east on the ellipsoid (Snyder 1987).
    assert "is 1.31 m in this projection" in notes["3857"][1]
    assert not any("in this projection" in line for code in ("32618", "2263") for line in notes[code])


@pytest.mark.parametrize(
    ("place", "code", "said"),
    [
        ((51.5, -0.13), 27700, "good to 2 m"),
        ((47.4, 8.54), 31467, "good to 3 m"),
        ((60.0, 8.54), 31467, "of unknown accuracy"),
        ((47.4, 8.54), 25832, ""),
        ((47.4, 8.54), 32632, ""),
    ],
)
def test_a_system_that_is_tied_to_wgs_84_by_metres_only_is_told(tmp_path, place, code, said):
    """OSGB36 (EPSG:1314), DHDN within Germany and beyond the area of its transformations, ETRS89, WGS 84."""
    origin = GeoOrigin(*place, 0.0)
    grid = Grid(-20.25, 10.25, 0.5, 80, 60, origin)
    write_bands(tmp_path / "elevation.tif", grid, {"height": np.ones((60, 80), np.float32)})
    there = exported(made_map(pose(), origin=origin), folder=tmp_path, crs=f"EPSG:{code}")
    notes = export_map(there, "geotiff", tmp_path / "out")
    assert [said in note for note in notes if "from WGS 84" in note] == [True] * bool(said)


@pytest.mark.parametrize(
    ("place", "system"), [((10.0, 180.0), 3857), ((89.9999, 0.0), 4326), ((-89.9999, 3.0), 5041)]
)
def test_a_raster_across_an_edge_of_the_system_is_refused_in_plain_words(tmp_path, place, system):
    origin = GeoOrigin(*place, 0.0)
    grid = Grid(-20.25, 10.25, 0.5, 80, 60, origin)
    write_bands(tmp_path / "elevation.tif", grid, {"height": np.ones((60, 80), np.float32)})
    there = exported(made_map(pose(), origin=origin), folder=tmp_path, crs=f"EPSG:{system}")
    with pytest.raises(InputError, match="lies across or beside an edge of this system"):
        export_map(there, "geotiff", tmp_path / "out")
    # UTM, or UPS at a pole, holds the same place.
    export_map(exported(made_map(pose(), origin=origin), folder=tmp_path), "geotiff", tmp_path / "out")


def test_all_pieces_of_a_raster_are_resampled(tmp_path, monkeypatch):
    east, north = np.meshgrid(np.arange(80.0), np.arange(60.0)[::-1])
    bands = {"east": east.astype(np.float32), "north": north.astype(np.float32)}
    write_bands(tmp_path / "elevation.tif", Grid(-0.5, 59.5, 1.0, 80, 60, ORIGIN), bands)
    monkeypatch.setattr(geotiff, "_PIECE_PX", 16)
    export_map(exported(made_map(pose(), origin=ORIGIN), folder=tmp_path), "geotiff", tmp_path / "out")
    with (
        rasterio.open(tmp_path / "out" / "elevation.tif") as raster,
        rasterio.open(tmp_path / "elevation.tif") as own,
    ):
        assert raster.descriptions == ("east", "north")
        values = raster.read()
        rows, cols = np.nonzero(np.isfinite(values[0]))
        assert len(rows) > 0.95 * 80 * 60
        xy = transform(raster.crs, own.crs, *(list(each) for each in raster.xy(rows, cols)))
    # The nearest cell, and the eighth of a pixel to which GDAL approximates a transformation.
    np.testing.assert_allclose(values[:, rows, cols], xy, rtol=0, atol=0.5 + 0.125)


def test_pixels_that_do_not_reach_the_disk_are_told(folder, tmp_path, monkeypatch):
    copy = rasterio.shutil.copy

    def losing(source, target, **options):
        copy(source, target, **options)
        with rasterio.open(target, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
            raster.write(np.zeros((1, raster.height, raster.width), np.float32))

    monkeypatch.setattr(rasterio.shutil, "copy", losing)
    with pytest.raises(InputError, match="pixels are missing"):
        export_map(exported(made_map(pose(), origin=ORIGIN), folder=folder), "geotiff", tmp_path / "out")


def test_a_map_without_rasters_is_refused(tmp_path):
    with pytest.raises(InputError, match="no rasters"):
        export_map(exported(made_map(pose()), folder=tmp_path), "geotiff", tmp_path / "out")


def test_earlier_rasters_stay_where_the_disk_is_full(folder, tmp_path, monkeypatch):
    target = tmp_path / "rasters"
    target.mkdir()
    (folder / "mosaic.tif").write_bytes((folder / "elevation.tif").read_bytes())
    files = {name: target / name for name in ("elevation.tif", "mosaic.tif")}
    files["elevation.tif"].write_text("earlier")
    reproject = geotiff._reproject

    def full(source, *others):
        if source.name == "mosaic.tif":
            raise OSError(errno.ENOSPC, "No space left on device")
        reproject(source, *others)

    monkeypatch.setattr(geotiff, "_reproject", full)
    with pytest.raises(OSError, match="No space left"):
        write_rasters(made_map(pose(), origin=ORIGIN), folder, files, "utm")
    assert {path.name: path.read_text() for path in target.iterdir()} == {"elevation.tif": "earlier"}
