"""``slam export`` on the command line."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.io.estimate import write_estimate
from slam.io.exports.formats import FORMATS
from tests.slam.io.exports.made_map import made_map, pose
from tests.slam.made_estimate import made_estimate


def run(*words):
    return CliRunner().invoke(app, ["export", *map(str, words)], env={"COLUMNS": "200"})


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "map").mkdir()
    write_estimate(made_map(pose(), pose((1.0, 0.0, 10.0))), tmp_path / "map")
    return tmp_path / "map"


def test_the_default_name_is_beside_the_folder(folder):
    done = run(folder, "--to", "gpx")
    assert done.exit_code == 0, done.output
    assert "map.gpx" in done.stdout
    assert sorted(path.name for path in folder.parent.iterdir()) == ["map", "map.gpx"]


def test_out_names_another_place(folder, tmp_path):
    done = run(folder, "--to", "tum", "--out", tmp_path / "new" / "poses.txt", "--quiet")
    assert done.exit_code == 0
    assert done.stdout == ""
    assert len((tmp_path / "new" / "poses.txt").read_text().splitlines()) == 3


def test_a_map_without_a_place_says_what_to_do(tmp_path):
    write_estimate(made_estimate(), tmp_path)
    done = run(tmp_path, "--to", "kml", "--out", tmp_path / "track.kml")
    assert done.exit_code == 1
    assert "the map has no place on Earth" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_another_folder_and_an_unknown_format_are_refused(tmp_path):
    done = run(tmp_path, "--to", "tum")
    assert done.exit_code == 1
    assert "estimate.npz" in done.stderr
    assert run(tmp_path, "--to", "shapefile").exit_code == 2


def test_help_and_completion_list_the_formats():
    text = " ".join(run("--help").stdout.split())
    for known in FORMATS:
        assert known.description.split()[0] in text
        assert f"{known.name}:" in text
    shown = CliRunner().invoke(
        app,
        env={"_SLAM_COMPLETE": "complete_bash", "COMP_WORDS": "slam export map --to ", "COMP_CWORD": "4"},
        prog_name="slam",
    )
    assert {known.name for known in FORMATS} <= set(shown.stdout.split())
