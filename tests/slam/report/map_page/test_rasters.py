"""Rasters of the page: tiles show each pixel at its place, and grids keep their values."""

from __future__ import annotations

import base64
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.io.geotiff import Grid, write_bands
from slam.report.map_page.rasters import TILE_PX, Image, TileSet, read_images, tile_set, value_grid


def picture(rows: int, cols: int) -> np.ndarray:
    """A smooth picture, so that WebP keeps it, with a hole."""
    y, x = np.mgrid[:rows, :cols]
    rgba = np.stack([255 * x / cols, 255 * y / rows, 128 + 0 * x, 255 + 0 * x], axis=-1).astype(np.uint8)
    rgba[rows // 3 : rows // 2, cols // 3 : cols // 2] = 0
    return rgba


def assembled(tiles: TileSet, name: str, level: int) -> np.ndarray:
    """The whole image of one level as (rows, cols, 4), red first."""
    size = TILE_PX * 2**level
    whole = np.zeros((size, size, 4), np.uint8)
    for key, code in tiles.tiles[name].items():
        z, x, y = map(int, key.split("/"))
        if z == level:
            pixels = cv2.imdecode(np.frombuffer(base64.b64decode(code), np.uint8), cv2.IMREAD_UNCHANGED)
            if pixels.shape[2] == 3:
                pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA)
            corner = slice(y * TILE_PX, (y + 1) * TILE_PX), slice(x * TILE_PX, (x + 1) * TILE_PX)
            whole[corner] = cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGBA)
    return whole


def error(found: np.ndarray, right: np.ndarray) -> float:
    seen = right[..., 3] > 0
    assert np.array_equal(found[..., 3] > 127, seen)
    return float(np.abs(found[seen].astype(float) - right[seen]).mean())


@pytest.mark.parametrize(("rows", "cols"), [(700, 900), (256, 256), (40, 30)])
def test_the_finest_tiles_show_the_image(rows, cols):
    right = picture(rows, cols)
    tiles = tile_set({"map": Image(right, -3.0, 2.0, 0.01)})
    assert (tiles.west_m, tiles.north_m, tiles.gsd_m) == (-3.0, 2.0, 0.01)
    found = assembled(tiles, "map", tiles.levels - 1)
    assert error(found[:rows, :cols], right) < 3
    assert not found[rows:, :, 3].any()
    assert not found[:, cols:, 3].any()


def test_a_coarser_level_shows_the_same_places():
    right = picture(1024, 768)
    tiles = tile_set({"map": Image(right, 0.0, 0.0, 0.01)})
    half = assembled(tiles, "map", tiles.levels - 2)[:512, :384]
    seen = cv2.resize(right, (384, 512), interpolation=cv2.INTER_AREA)[..., 3] == 255
    assert np.abs(half[seen].astype(float) - right[::2, ::2][seen])[..., :3].mean() < 4


def test_images_share_one_frame_though_their_corners_differ():
    main, other = picture(300, 400), picture(350, 420)
    tiles = tile_set({"map": Image(main, 1.0, 5.0, 0.01), "chain": Image(other, 0.5, 5.25, 0.01)})
    assert (tiles.west_m, tiles.north_m) == (0.5, 5.25)
    finest = tiles.levels - 1
    assert error(assembled(tiles, "map", finest)[25:325, 50:450], main) < 3
    assert error(assembled(tiles, "chain", finest)[:350, :420], other) < 3


def test_empty_places_have_no_tiles():
    rgba = np.zeros((600, 1500, 4), np.uint8)
    rgba[:40, :40] = 200
    tiles = tile_set({"map": Image(rgba, 0.0, 0.0, 1.0)})
    assert sorted(tiles.tiles["map"]) == [f"{z}/0/0" for z in range(tiles.levels)]


def test_large_pictures_are_reduced_alike_and_stay_in_place(tmp_path: Path):
    paths = {}
    for name, shape in (("map", (400, 600)), ("chain", (300, 300))):
        paths[name] = tmp_path / f"{name}.png"
        cv2.imwrite(str(paths[name]), cv2.cvtColor(picture(*shape), cv2.COLOR_RGBA2BGRA))
        # A world file has the centre of the first pixel.
        paths[name].with_suffix(".pgw").write_text("0.02\n0\n0\n-0.02\n7.01\n3.99\n")
    found = read_images(paths, most_pixels=30_000)
    assert found["map"].rgba.shape == (133, 200, 4)
    assert found["chain"].rgba.shape == (100, 100, 4)
    for image in found.values():
        assert (image.west_m, image.north_m, image.gsd_m) == pytest.approx((7.0, 4.0, 0.06))


def test_a_grid_keeps_its_values_and_its_gaps(tmp_path: Path):
    values = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    values[1, 2] = np.nan
    write_bands(tmp_path / "values.tif", Grid(-1.0, 2.0, 0.5, 4, 3), {"first": 0 * values, "second": values})
    grid = value_grid(tmp_path / "values.tif", 2)
    assert grid is not None
    assert (grid["west"], grid["north"], grid["cell"], grid["cols"], grid["rows"]) == (-1.0, 2.0, 0.5, 4, 3)
    found = np.frombuffer(base64.b64decode(grid["data"]), "<f4").reshape(3, 4)
    np.testing.assert_array_equal(found, values)
    assert 0 <= grid["low"] < grid["high"] <= 1


def test_a_grid_without_values_is_none(tmp_path: Path):
    write_bands(
        tmp_path / "values.tif", Grid(1.0, 0.0, 1.0, 4, 3), {"none": np.full((3, 4), np.nan, np.float32)}
    )
    assert value_grid(tmp_path / "values.tif", 1) is None
