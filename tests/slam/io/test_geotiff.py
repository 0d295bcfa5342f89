"""Mosaic files, read back with rasterio and OpenCV."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.warp import transform

from slam.core.control_points import ControlReport, PointResidual
from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.summary import summarise
from slam.io.geotiff import Block, Grid, height_tags, write_bands, write_geotiff, write_png
from slam.report.coordinates import datum_text
from tests.slam.made_estimate import made_estimate

ORIGIN = GeoOrigin(30.1712345678, -98.0897654321, 300.0)


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rgba = rng.integers(0, 256, (height, width, 4), np.uint8)
    rgba[..., 3] = 255
    rgba[: height // 4, : width // 3] = 0
    return rgba


def blocks(rgba: np.ndarray, side: int = 512) -> Iterator[Block]:
    for r in range(0, rgba.shape[0], side):
        for c in range(0, rgba.shape[1], side):
            yield Block(r, c, rgba[r : r + side, c : c + side])


@pytest.mark.parametrize("origin", [None, ORIGIN])
@pytest.mark.parametrize("shape", [(1, 1), (37, 700), (1300, 1025)])
def test_pixels_and_position_are_read_back(
    tmp_path: Path, shape: tuple[int, int], origin: GeoOrigin | None
) -> None:
    rgba = picture(*shape)
    grid = Grid(-12.5, 40.25, 0.05, shape[1], shape[0], origin)
    write_geotiff(tmp_path / "m.tif", grid, blocks(rgba))
    with rasterio.open(tmp_path / "m.tif") as raster:
        np.testing.assert_array_equal(np.moveaxis(raster.read(), 0, 2), rgba)
        assert raster.xy(0, 0) == pytest.approx((-12.5 + 0.025, 40.25 - 0.025))
        assert raster.colorinterp[3] == ColorInterp.alpha
        assert raster.crs.is_projected == (origin is not None)
        assert 'UNIT["metre",1' in raster.crs.to_wkt()
    assert [p.name for p in tmp_path.iterdir()] == ["m.tif"]


@pytest.mark.parametrize("altitude_m", [0.0, 300.0])
def test_world_is_east_and_north_of_the_origin(tmp_path: Path, altitude_m: float) -> None:
    origin = GeoOrigin(ORIGIN.latitude_deg, ORIGIN.longitude_deg, altitude_m)
    grid = Grid(-4, 4, 1.0, 8, 8, origin)
    write_geotiff(tmp_path / "m.tif", grid, blocks(picture(8, 8)))
    w_p_m = np.array([[0, 0, 0], [150, 0, 0], [0, 150, 0], [-400, 300, 0.0]])
    lat, lon, _ = geodetic_from_enu(w_p_m, origin)
    with rasterio.open(tmp_path / "m.tif") as raster:
        x, y = transform("EPSG:4326", raster.crs, lon, lat)
    on_ellipsoid = w_p_m[:, :2] / (1 + altitude_m / 6.371e6)
    np.testing.assert_allclose(np.column_stack([x, y]), on_ellipsoid, atol=2e-3)
    assert abs(x[0]) < 1e-4
    assert abs(y[0]) < 1e-4


def test_file_is_cloud_optimised(tmp_path: Path) -> None:
    rgba = picture(2100, 2300)
    write_geotiff(tmp_path / "m.tif", Grid(0, 0, 0.1, 2300, 2100, ORIGIN), blocks(rgba))
    with rasterio.open(tmp_path / "m.tif") as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.block_shapes[0] == (512, 512)
        assert raster.overviews(1) == [2, 4, 8]
        assert raster.compression.name == "deflate"
    with rasterio.open(tmp_path / "m.tif", overview_level=0) as half:
        small = np.moveaxis(half.read(), 0, 2)
    want = cv2.resize(rgba[-1000:, -1000:, :3].astype(float), (500, 500), interpolation=cv2.INTER_AREA)
    assert np.abs(small[-500:, -500:, :3] - want).max() <= 1


@pytest.mark.parametrize(("most_pixels", "overviews"), [(600 * 700, []), (600 * 700 - 1, [2])])
def test_a_raster_has_overviews_only_above_the_pixels_that_its_picture_may_have(
    tmp_path: Path, most_pixels: int, overviews: list[int]
) -> None:
    path = tmp_path / "mosaic.tif"
    write_geotiff(path, Grid(0.0, 0.0, 0.1, 700, 600), blocks(picture(600, 700)), most_pixels=most_pixels)
    with rasterio.open(path) as raster:
        assert raster.overviews(1) == overviews


def test_png_and_world_file_agree_with_the_geotiff(tmp_path: Path) -> None:
    rgba = picture(900, 1200)
    write_geotiff(tmp_path / "m.tif", Grid(-3.0, 7.0, 0.02, 1200, 900), blocks(rgba))
    assert write_png(tmp_path / "m.tif", tmp_path / "m.png", 2_000_000) == 0.02
    read = cv2.imread(str(tmp_path / "m.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cv2.cvtColor(read, cv2.COLOR_BGRA2RGBA), rgba)
    world = [float(line) for line in (tmp_path / "m.pgw").read_text().split()]
    assert world == pytest.approx([0.02, 0, 0, -0.02, -2.99, 6.99])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.pgw", "m.png", "m.tif"]


@pytest.mark.parametrize("shape", [pytest.param((1800, 2400), marks=pytest.mark.slow), (1801, 2403)])
def test_large_png_is_reduced_and_its_world_file_follows(tmp_path: Path, shape: tuple[int, int]) -> None:
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    mark = 255 * np.exp(-((rows - 1203.0) ** 2 + (cols - 1607.0) ** 2) / (2 * 12.0**2))
    rgba = np.dstack([mark.astype(np.uint8)] * 3 + [np.full(shape, 255, np.uint8)])
    write_geotiff(tmp_path / "m.tif", Grid(100.0, 50.0, 0.5, shape[1], shape[0]), blocks(rgba))
    gsd = write_png(tmp_path / "m.tif", tmp_path / "m.png", 300_000)
    read = cv2.imread(str(tmp_path / "m.png"), cv2.IMREAD_UNCHANGED)[..., 0].astype(float)
    assert read.size <= 300_000
    a, _, _, e, x0, y0 = (float(line) for line in (tmp_path / "m.pgw").read_text().split())
    assert gsd == pytest.approx(a)
    assert a == pytest.approx(2.0, rel=0.01)
    r, c = np.mgrid[: read.shape[0], : read.shape[1]]
    x, y = x0 + a * (read * c).sum() / read.sum(), y0 + e * (read * r).sum() / read.sum()
    truth = (100.0 + 0.5 * 1607.5, 50.0 - 0.5 * 1203.5)
    # A tenth of a pixel of the reduced picture.
    assert np.hypot(x - truth[0], y - truth[1]) < 0.2


def test_failure_leaves_only_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "m.tif").write_text("old")

    def breaks() -> Iterator[Block]:
        yield Block(0, 0, picture(64, 64))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_geotiff(tmp_path / "m.tif", Grid(-4, 4, 1, 128, 128), breaks())
    assert (tmp_path / "m.tif").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["m.tif"]


def test_unwritable_path_is_a_one_line_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError) as caught:
        write_geotiff(tmp_path / "file" / "m.tif", Grid(-4, 4, 1, 8, 8), blocks(picture(8, 8)))
    assert "\n" not in str(caught.value)
    assert "m.tif" in str(caught.value) or "file" in str(caught.value)


FULL_DISK = """
import resource, sys
from pathlib import Path
from slam.core.errors import InputError
from slam.io.geotiff import Grid, write_geotiff, write_png
from tests.slam.io.test_geotiff import blocks, picture
folder, limit = Path(sys.argv[1]), int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    if sys.argv[3] == "tif":
        write_geotiff(folder / "m.tif", Grid(-4, 4, 0.1, 900, 700), blocks(picture(700, 900)))
    else:
        write_png(folder / "old.tif", folder / "m.png", 10**6)
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("kind", "share"),
    [
        *(
            pytest.param(kind, share, marks=pytest.mark.slow)
            for kind in ("tif", "png")
            for share in (0.02, 0.5)
        ),
        ("tif", 0.97),
        ("png", 0.97),
    ],
)
def test_full_disk_is_reported_and_leaves_nothing(tmp_path: Path, kind: str, share: float) -> None:
    write_geotiff(tmp_path / "old.tif", Grid(-4, 4, 0.1, 900, 700), blocks(picture(700, 900)))
    write_png(tmp_path / "old.tif", tmp_path / "old.png", 10**6)
    before = sorted(p.name for p in tmp_path.iterdir())
    limit = int(share * (tmp_path / f"old.{kind}").stat().st_size)
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path), str(limit), kind]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert f"m.{kind}: cannot be written" in done.stdout
    assert done.stdout.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == before


@pytest.mark.parametrize("writes", ["colours", "values"])
def test_a_raster_names_its_coordinate_system_and_says_where_heights_begin(tmp_path, writes):
    estimate = replace(made_estimate(), origin=ORIGIN, floor_z_m=-1.5)
    path, grid, tags = tmp_path / "m.tif", Grid(0, 0, 0.1, 64, 64, ORIGIN), height_tags(estimate)
    if writes == "colours":
        write_geotiff(path, grid, blocks(picture(64, 64)), tags)
    else:
        write_bands(path, grid, {"height": np.zeros((64, 64), np.float32)}, tags)
    with rasterio.open(path) as raster:
        wkt, told = raster.crs.to_wkt(), raster.tags()
        assert wkt.startswith(f'PROJCS["azimuthal equidistant on WGS 84 about {ORIGIN.latitude_deg:.7f}, ')
        assert 'GEOGCS["WGS 84"' in wkt
    assert float(told["FLOOR_ALTITUDE_M"]) == pytest.approx(ORIGIN.altitude_m - 1.5, abs=1e-3)
    assert told["VERTICAL_DATUM"] == "reference of the recorded altitudes"
    used = PointResidual(name="P", role="control", used=True, reason="", views=3)
    control = replace(estimate, control=ControlReport(points=(used,)))
    assert height_tags(control)["VERTICAL_DATUM"] == "reference of the control points"
    assert height_tags(replace(estimate, origin=None)) == {}
    no_altitude = replace(estimate, origin=replace(ORIGIN, altitude_m=0.0, altitude_known=False))
    assert height_tags(no_altitude) == {"VERTICAL_DATUM": "the map's floor: no altitude is recorded"}
    surveyed = replace(used, surveyed_m=(1.0, 2.0, 3.0))
    by_control = replace(no_altitude, control=ControlReport(points=(surveyed,)))
    assert height_tags(by_control)["VERTICAL_DATUM"] == "reference of the control points"


def test_a_level_that_is_stated_is_told(tmp_path):
    """Control points with heights place the map in their system; without, it keeps that of the fixes."""
    origin = replace(ORIGIN, height_system="EPSG:4979")
    estimate = replace(made_estimate(), origin=origin, floor_z_m=-1.5)
    tags = height_tags(estimate)
    assert (tags["VERTICAL_DATUM"], tags["VERTICAL_CRS"]) == ("the WGS 84 ellipsoid (EPSG:4979)", "EPSG:4979")
    assert summarise(estimate).to_json()["height_system"] == "EPSG:4979"
    assert "over the WGS 84 ellipsoid (EPSG:4979)" in datum_text(estimate)
    flat = PointResidual(name="P", role="control", used=True, reason="", views=3, surveyed_m=(1, 2, np.nan))
    for up, system in ((np.nan, "EPSG:4979"), (3.0, "EPSG:5783")):
        points = (replace(flat, surveyed_m=(1.0, 2.0, up)),)
        control = ControlReport(points=points, height_system="EPSG:5783")
        assert height_tags(replace(estimate, control=control))["VERTICAL_CRS"] == system
    unknown = replace(estimate, origin=ORIGIN)
    assert summarise(unknown).to_json()["height_system"] == "unknown"
    assert "height_system" not in summarise(replace(estimate, origin=None)).to_json()
