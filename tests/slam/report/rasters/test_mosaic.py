"""From an estimate and its flight to mosaic files."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

import frontend.mosaic.canvas
import slam.report.rasters.mosaic
from frontend.mosaic.plan import plan_mosaic
from slam.core.errors import InputError
from slam.core.estimate import Estimate, over_floor
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin
from slam.core.streams import Frames
from slam.report.rasters.mosaic import write_chain_picture, write_mosaic
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, photograph, pose, smooth_floor, survey

COARSE_M = 0.03
"""Metres a pixel where a test asks for no detail of the ground."""
FILES = ["mosaic.pgw", "mosaic.png", "mosaic.tif", "mosaic_quality.png", "mosaic_quality.tif"]


def scene(seed: int = 1) -> tuple[Estimate, Flight, list[np.ndarray | None]]:
    """A flight of twice as many frames as keyframes."""
    poses = survey(seed)
    n = len(poses)
    frames: list[np.ndarray | None] = []
    for T in poses:
        frames += [None, photograph(smooth_floor(1), CAMERA, T, 1)]
    index = 2 * np.arange(n) + 1
    unknown = np.full((n, 6, 6), np.nan)
    names = tuple(f"{k}.png" for k in index)
    estimate = Estimate(
        name="made",
        epoch_ns=0,
        stamps_s=np.arange(n) * 1.0,
        frame_names=names,
        frame_index=index,
        w_T_b=poses,
        covariances=unknown,
        over_floor_covariances=unknown,
        component=np.zeros(n, np.int64),
        camera=CAMERA,
        floor_z_m=FLOOR_Z_M,
        origin=None,
        relative_poses=(),
        loops=(),
        chain_w_T_b=poses,
        odometry_w_T_b=poses,
    )
    names = tuple(f"{k}.png" for k in range(2 * n))
    return (
        estimate,
        Flight("made", camera=CAMERA, frames=Frames(np.arange(2.0 * n), names, frames.__getitem__)),
        frames,
    )


def test_pictures_from_below_the_floor_show_the_foot_of_a_hillside(tmp_path: Path) -> None:
    """The floor has the height of the origin: far down the slope it lies above the cameras."""
    estimate, flight, _ = scene()
    over_plane = estimate.w_T_b.copy()
    over_plane[:, 1, 3] -= 12.0
    down = over_floor(over_plane, (-0.4, 0.0), FLOOR_Z_M)
    assert (down[:, 2, 3] < FLOOR_Z_M).all()
    estimate = dataclasses.replace(estimate, w_T_b=down, floor_slope_rad=(0.4, 0.0))
    files = write_mosaic(estimate, flight, tmp_path, 2 * COARSE_M)
    assert files.left_out == {}
    assert files.pictures + files.redundant == 12
    assert files.ground.surface is not None
    assert files.ground.surface.height_m.max() < -12.0 * np.sin(0.4) / 2


def test_files_hold_the_floor_where_it_lies(tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    told: list[tuple[str, int, int]] = []
    files = write_mosaic(estimate, flight, tmp_path / "new", progress=lambda *step: told.append(step))
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == FILES
    assert files.pictures + files.redundant == 12
    assert list(files.not_drawn.values()) == ["other pictures show its ground"] * files.redundant
    assert files.left_out == {}
    assert files.note == ""
    assert files.geotiff is not None
    assert files.quality is not None
    with rasterio.open(files.geotiff) as raster, rasterio.open(files.quality) as bands:
        assert bands.count == len(bands.descriptions) == 3
        assert bands.bounds.left == pytest.approx(raster.bounds.left)
        assert bands.bounds.top == pytest.approx(raster.bounds.top)
        # Cells at the border, of which only the edge was drawn, have none.
        drawn = np.isfinite(bands.read(1)).repeat(16, axis=0).repeat(16, axis=1)
        assert drawn[: raster.height, : raster.width][raster.read(4) > 0].mean() > 0.98
    with rasterio.open(files.geotiff) as raster:
        rgba = np.moveaxis(raster.read(), 0, 2)
        x, y = raster.xy(*np.nonzero(rgba[..., 3]))
        assert raster.res == pytest.approx((files.gsd_m, files.gsd_m))
        assert raster.crs.to_wkt().startswith("LOCAL_CS")
    some = np.random.default_rng(2).choice(len(x), 5000, replace=False)
    floor = smooth_floor(1).at(np.array([x])[:, some], np.array([y])[:, some])[0, :, ::-1]
    assert (rgba[rgba[..., 3] > 0][some, :3] - floor).std() < 4
    assert {s for s, _, _ in told} == {"mosaic exposure", "mosaic"}
    assert all(a[1] <= b[1] for a, b in pairwise(told) if a[0] == b[0])
    assert {(d, t) for s, d, t in told if d == t and s == "mosaic"}


@pytest.mark.usefixtures("no_quality_picture")
def test_georeferenced_with_an_origin(tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    origin = GeoOrigin(52.0, 4.4, 3.0)
    files = write_mosaic(dataclasses.replace(estimate, origin=origin), flight, tmp_path, COARSE_M)
    with rasterio.open(files.geotiff) as raster:
        assert raster.crs.to_dict()["proj"] == "aeqd"
        assert raster.crs.to_dict()["lat_0"] == 52.0


def test_lengths_that_are_no_metres_are_not_called_so(tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    files = write_mosaic(dataclasses.replace(estimate, metric=False), flight, tmp_path, COARSE_M)
    assert files.quality is not None
    for path in (files.geotiff, files.quality):
        with rasterio.open(path) as raster:
            assert raster.crs is None
            assert raster.res[0] > 0


@pytest.mark.usefixtures("no_quality_picture")
def test_chain_beside_the_map_is_a_picture_alone(tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    bent = estimate.w_T_b.copy()
    bent[:, 0, 3] += np.linspace(0, 2, len(bent))
    made = write_mosaic(estimate, flight, tmp_path / "map", COARSE_M)
    picture = write_chain_picture(estimate, flight, tmp_path / "chain", bent, made.png_gsd_m)
    assert picture.name == "mosaic_chain.png"
    assert sorted(p.name for p in (tmp_path / "chain").iterdir()) == ["mosaic_chain.pgw", picture.name]
    assert cv2.imread(str(picture)).shape[1] > cv2.imread(str(made.png)).shape[1] + 50


@pytest.mark.usefixtures("no_quality_picture")
def test_what_is_left_out_is_counted(tmp_path: Path) -> None:
    estimate, flight, frames = scene()
    frames[1], frames[3] = None, np.zeros((150, 200, 3), np.uint8)
    poses, component = estimate.w_T_b.copy(), estimate.component.copy()
    poses[2], component[2] = np.nan, -1
    component[3] = 1
    estimate = dataclasses.replace(estimate, w_T_b=poses, component=component)
    files = write_mosaic(estimate, flight, tmp_path, COARSE_M)
    assert files.left_out == {
        "in a part of the flight that is not tied to the largest": 1,
        "cannot be read": 1,
        "black or blown out": 1,
        "not placed": 1,
    }
    assert files.not_drawn == {
        "1.png": "cannot be read",
        "3.png": "black or blown out",
        "5.png": "not placed",
        "7.png": "in a part of the flight that is not tied to the largest",
    }
    located = dataclasses.replace(estimate, origin=GeoOrigin(52.0, 4.4, 3.0))
    assert sum(write_mosaic(located, flight, tmp_path, COARSE_M).left_out.values()) == 3


@pytest.mark.usefixtures("no_quality_picture")
def test_budget_is_kept_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimate, flight, _ = scene()
    monkeypatch.setattr(slam.report.rasters.mosaic, "MAX_MOSAIC_PIXELS", 40_000)
    monkeypatch.setattr(slam.report.rasters.mosaic, "MAX_PNG_PIXELS", 20_000)
    files = write_mosaic(estimate, flight, tmp_path, gsd_m=None)
    assert files.width * files.height <= 40_000
    assert "m/pixel" in files.note
    without_metres = dataclasses.replace(estimate, metric=False)
    note = write_mosaic(without_metres, flight, tmp_path, gsd_m=None).note
    assert "heights/pixel" in note
    assert " m/pixel" not in note
    asked = write_mosaic(estimate, flight, tmp_path, gsd_m=0.02)
    assert asked.gsd_m == 0.02
    assert asked.note == ""


@pytest.mark.usefixtures("no_quality_picture")
def test_refusals_are_one_line_and_leave_earlier_files(tmp_path: Path) -> None:
    estimate, flight, frames = scene()
    write_mosaic(estimate, flight, tmp_path, COARSE_M)
    before = (tmp_path / "mosaic.tif").read_bytes()
    blind = dataclasses.replace(flight, frames=None)
    under = dataclasses.replace(estimate, floor_z_m=50.0)
    # Over their sloping floor these pictures look down, and in the level world at the sky.
    turned_over = over_floor(estimate.w_T_b, (-3.0, 0.0), FLOOR_Z_M)
    sky = dataclasses.replace(estimate, w_T_b=turned_over, floor_slope_rad=(3.0, 0.0))
    for who, what, gsd_m, word in [
        (estimate, blind, None, "no camera"),
        (under, flight, None, "below the floor"),
        (sky, flight, COARSE_M, "no picture can be put into a mosaic"),
        (estimate, flight, float("nan"), "above 0"),
        (estimate, flight, -1.0, "above 0"),
        (estimate, flight, 1e-7, "coarser"),
    ]:
        with pytest.raises(InputError, match=word) as caught:
            write_mosaic(who, what, tmp_path, gsd_m=gsd_m)
        assert "\n" not in str(caught.value)
    frames[:] = [None] * len(frames)
    with pytest.raises(InputError, match="cannot be read"):
        write_mosaic(estimate, flight, tmp_path)
    assert (tmp_path / "mosaic.tif").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == FILES
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError):
        write_mosaic(*scene()[:2], tmp_path / "file")


@pytest.mark.usefixtures("no_quality_picture")
def test_same_input_gives_the_same_files(tmp_path: Path) -> None:
    estimate, flight, _ = scene()
    a, b = (write_mosaic(estimate, flight, tmp_path / n, COARSE_M) for n in "ab")
    assert cv2.imread(str(a.png), cv2.IMREAD_UNCHANGED).tobytes() == cv2.imread(str(b.png), -1).tobytes()


@pytest.mark.usefixtures("no_quality_picture")
@pytest.mark.parametrize("slope_rad", [0.0, pytest.param(0.1, marks=pytest.mark.slow)])
def test_far_ground_of_a_tilted_picture_does_not_coarsen_the_mosaic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slope_rad: float
) -> None:
    estimate, flight, frames = scene()
    frames[1] = photograph(smooth_floor(1), CAMERA, far := pose(1.2, 0.5, 2.0, 0.3, -0.9), 1)
    poses = estimate.w_T_b.copy()
    poses[0] = far
    estimate = dataclasses.replace(estimate, w_T_b=poses, floor_slope_rad=(slope_rad, 0.0))
    whole = plan_mosaic(CAMERA, estimate.over_floor_T_b, FLOOR_Z_M, COARSE_M)
    monkeypatch.setattr(frontend.mosaic.canvas, "MAX_PIXELS", whole.width * whole.height * 7 // 8)
    files = write_mosaic(estimate, flight, tmp_path, COARSE_M)
    ((name, told),) = files.partly_drawn.items()
    assert name == "1.png"
    assert told.endswith("of its ground is so far away that it would take too many of the mosaic's pixels")
    assert files.gsd_m == whole.gsd_m
    assert files.width * files.height <= 0.875 * whole.width * whole.height
    assert (files.ground.surface is not None) == (slope_rad > 0)
