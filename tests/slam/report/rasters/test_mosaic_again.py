"""A mosaic drawn where one stands already: the same files, and fewer tiles rendered."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.windows import Window

from slam.io.geotiff import earlier_blocks
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.report.rasters.test_mosaic import COARSE_M, scene

GSD_M = 0.0035


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mosaic of several tiles."""
    folder = tmp_path_factory.mktemp("first")
    made = write_mosaic(*scene()[:2], folder, GSD_M)
    assert made.tiles >= 4
    assert made.kept == 0
    return folder / "mosaic.tif"


@pytest.mark.slow
def test_nothing_changed_none_rendered(first: Path, tmp_path: Path) -> None:
    again = write_mosaic(*scene()[:2], tmp_path, GSD_M, earlier=first)
    assert again.kept == again.tiles
    assert content(tmp_path) == content(first.parent)
    replaced = write_mosaic(*scene()[:2], tmp_path, GSD_M)
    assert replaced.kept == replaced.tiles, "the file that is replaced is the earlier one"
    assert content(tmp_path) == content(first.parent)


@pytest.mark.slow
def test_a_moved_keyframe_gives_what_a_whole_rendering_gives(first: Path, tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    poses = estimate.w_T_b.copy()
    poses[0, :2, 3] += 0.001
    moved = dataclasses.replace(estimate, w_T_b=poses)
    again = write_mosaic(moved, flight, tmp_path / "again", GSD_M, earlier=first)
    whole = write_mosaic(moved, flight, tmp_path / "whole", GSD_M)
    assert 0 < again.kept < again.tiles
    assert whole.kept == 0
    assert content(tmp_path / "again") == content(tmp_path / "whole")
    assert content(tmp_path / "again")["mosaic.tif"] != first.read_bytes()


@pytest.mark.slow
def test_another_resolution_renders_all(first: Path, tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    assert write_mosaic(estimate, flight, tmp_path, 0.004, earlier=first).kept == 0


@pytest.mark.usefixtures("no_quality_picture")
def test_a_file_that_is_not_as_it_was_written_gives_nothing(tmp_path: Path) -> None:
    # One coarse tile: what is asked is whether a damaged file is taken for a whole one.
    whole = write_mosaic(*scene()[:2], tmp_path / "whole", COARSE_M)
    first = whole.geotiff
    for name, damage in {
        "text": lambda path: path.write_text("not a picture"),
        "empty": lambda path: path.write_bytes(b""),
        "torn": lambda path: path.write_bytes(first.read_bytes()[:3000]),
        "folder": lambda path: path.mkdir(),
        "foreign": foreign,
        "nonsense": nonsense,
    }.items():
        path = tmp_path / name
        damage(path)
        with earlier_blocks(path) as known:
            assert known("a", (9, 9)) is None, name
    made = write_mosaic(*scene()[:2], tmp_path / "out", COARSE_M, earlier=tmp_path / "torn")
    assert made.kept == 0
    assert content(tmp_path / "out") == content(first.parent)


@pytest.mark.slow
def test_an_edited_tile_is_rendered_again(first: Path, tmp_path: Path) -> None:
    path = tmp_path / "edited.tif"
    path.write_bytes(first.read_bytes())
    with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
        spot = Window(raster.width // 2, raster.height // 2, 3, 3)
        raster.write(np.full((4, 3, 3), 255, np.uint8), window=spot)
    made = write_mosaic(*scene()[:2], tmp_path / "out", GSD_M, earlier=path)
    assert made.kept == made.tiles - 1
    assert content(tmp_path / "out") == content(first.parent)


def foreign(path: Path) -> None:
    profile = {"driver": "GTiff", "width": 9, "height": 9, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", **profile, transform=rasterio.Affine.scale(2.0)) as raster:
        raster.write(np.ones((1, 9, 9), np.float32))


def nonsense(path: Path) -> None:
    """The right metadata item with something else in it."""
    foreign(path)
    with rasterio.open(path, "r+") as raster:
        raster.update_tags(LEMNISCATE_BLOCKS='["a", 1]')
