"""``slam optimize --crs``: what is refused before the work, and the files that it adds."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import rasterio

from slam.cli.output_folder import OPTIMIZE_NAMES, RASTERS_IN_SYSTEM, output_folder
from slam.cli.results import _write_in_system
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.core.messages import Kind
from slam.core.streams import Gps
from slam.io.exports.geotiff import RASTERS
from slam.io.flight_folder import write_flight
from slam.io.geotiff import Grid, write_bands
from slam.simulation import simulate
from tests.slam.cli.commands import assert_refused, run
from tests.slam.cli.tiny_flight import RECIPE
from tests.slam.evaluation.scene import flight_of, smooth_poses
from tests.slam.io.exports.made_map import made_map, pose

ORIGIN = GeoOrigin(40.5, -74.4, 30.0)


def test_every_raster_has_its_name_in_the_other_system():
    assert set(RASTERS_IN_SYSTEM) == set(RASTERS)
    assert not set(RASTERS_IN_SYSTEM.values()) & set(OPTIMIZE_NAMES)


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        (("--crs", "EPSG:99999"), "give utm, or EPSG: and its number"),
        (("--crs", "utm", "--no-mosaic"), "with --no-mosaic there are no rasters"),
        (("--crs", "utm"), "the flight has no place on Earth"),
    ],
)
def test_what_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch, options, saying):
    def work(*_arguments: object) -> None:
        raise AssertionError("the flight is mapped")

    flight = flight_of(smooth_poses(np.random.default_rng(0), 4))
    monkeypatch.setattr("slam.cli.source.open_flight", lambda *_arguments: (flight, "flight"))
    monkeypatch.setattr("slam.mapping.pipeline.optimize_with_observations", work)
    assert_refused(run("optimize", tmp_path, "--out", tmp_path / "out", *options), saying)
    assert os.listdir(tmp_path) == []


def test_a_graph_has_no_rasters(tmp_path):
    graph = tmp_path / "a.g2o"
    graph.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert_refused(run("optimize", graph, "--out", tmp_path / "out", "--crs", "utm"), "--crs: .* is a graph")


def elevation(folder, origin):
    write_bands(
        folder / "elevation.tif",
        Grid(-20.0, 10.0, 0.5, 80, 60, origin),
        {"height": np.ones((60, 80), np.float32)},
    )
    return made_map(pose(), origin=origin)


def test_the_files_belong_to_the_output_that_a_new_run_replaces(tmp_path):
    with output_folder(tmp_path / "out") as folder:
        (note,) = _write_in_system(folder, elevation(folder, ORIGIN), "utm")
    assert note.kind is Kind.NOTE
    assert "elevation_crs.tif: coordinate system: EPSG:32618" in note.text
    assert {"elevation.tif", "elevation_crs.tif"} < set(os.listdir(tmp_path / "out"))
    for name in ("elevation_crs.tif", "elevation.tif", "mosaic_quality_crs.tif", "mosaic_chain.png"):
        (tmp_path / "out" / f"{name}.aux.xml").write_text("statistics of a GIS")
    with output_folder(tmp_path / "out"):
        pass
    assert "elevation_crs.tif" not in os.listdir(tmp_path / "out")


def test_a_map_is_kept_whose_rasters_the_system_cannot_hold(tmp_path):
    (warning,) = _write_in_system(tmp_path, elevation(tmp_path, GeoOrigin(10.0, 180.0, 0.0)), "EPSG:3857")
    assert warning.kind is Kind.WARNING
    assert "elevation.tif lies across" in str(warning)
    assert os.listdir(tmp_path) == ["elevation.tif"]


def test_a_map_on_earth_is_written_in_utm_unless_another_system_or_none_is_named(tmp_path):
    estimate = elevation(tmp_path, ORIGIN)
    for wanted, code in (("none", None), ("None", None), (None, 32618), ("EPSG:2263", 2263)):
        messages = _write_in_system(tmp_path, estimate, wanted)
        path = tmp_path / "elevation_crs.tif"
        assert path.exists() == bool(messages) == (code is not None)
        if code is not None:
            with rasterio.open(path) as raster:
                assert raster.crs.to_epsg() == code
                assert raster.descriptions == ("height",)


def test_nothing_is_said_of_a_system_that_nobody_asked_for(tmp_path):
    nowhere = replace(elevation(tmp_path, None), origin=None)
    assert _write_in_system(tmp_path, nowhere, None) == ()
    assert _write_in_system(tmp_path, nowhere, "utm") != ()
    (tmp_path / "elevation.tif").unlink()
    assert _write_in_system(tmp_path, made_map(pose(), origin=ORIGIN), None) == ()


@pytest.mark.slow
def test_optimize_writes_the_rasters_that_an_export_writes(tmp_path):
    (tmp_path / "tiny.toml").write_text(RECIPE.format(texture="puzzle"))
    flown = simulate(tmp_path / "tiny.toml", 3)
    places = geodetic_from_enu(flown.truth.w_T_b[:, :3, 3], ORIGIN)
    gps = Gps(flown.truth.stamps_s, *places, (0.01,) * 3, height_system="EPSG:4979")
    write_flight(replace(flown, gps=gps), tmp_path / "placed")
    result = run("optimize", tmp_path / "placed", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert set(os.listdir(tmp_path / "out")) == {*OPTIMIZE_NAMES, *RASTERS_IN_SYSTEM.values()}
    notes = json.loads((tmp_path / "out" / "summary.json").read_text())["notes"]
    assert any("EPSG:32618" in note for note in notes)
    assert run("export", tmp_path / "out", "--to", "geotiff", "--quiet").exit_code == 0
    for name, ours in RASTERS_IN_SYSTEM.items():
        with rasterio.open(tmp_path / "out" / ours) as a, rasterio.open(tmp_path / "out_geotiff" / name) as b:
            assert a.tags() == b.tags()
            assert (a.crs, a.transform) == (b.crs, b.transform)
            np.testing.assert_array_equal(a.read(), b.read())
