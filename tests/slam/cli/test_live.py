"""``slam live``."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from pathlib import Path

import cv2
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from slam.cli import app
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from tests.slam.small_flight import flown, only, photographs


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("live") / "flight"
    write_flight(only(flown(0), range(36)), path)
    return path


def test_a_growing_folder_is_mapped_to_its_end(recorded, tmp_path, monkeypatch):
    """The folder has 20 pictures at the first look, 8 more at each later one, and then no more."""
    growing, out, preview = tmp_path / "growing", tmp_path / "out", tmp_path / "preview.png"
    mcap = tmp_path / "live.mcap"
    shutil.copytree(recorded, growing)
    table = growing / "mav0/cam0/data.csv"
    rows = table.read_text().splitlines(keepends=True)
    table.write_text("".join(rows[:21]))
    looks = []

    def grown(source):
        looks.append(source)
        table.write_text("".join(rows[: 21 + 8 * max(0, len(looks) - 2)]))
        return read_flight(source)

    monkeypatch.setattr("slam.io.flight_folder.read_flight", grown)
    command = [
        "live",
        str(growing),
        "--out",
        str(out),
        "--follow",
        "0.5",
        "--no-mosaic",
        "--preview",
        str(preview),
        "--mcap",
        str(mcap),
    ]
    result = CliRunner().invoke(app, [*command, "--json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert len(looks) > 3
    assert summary["frames"] == len(rows) - 1
    assert (out / "trajectory.tum").exists()
    assert "In flight" in (out / "report.html").read_text()
    assert cv2.imread(str(preview)).std() > 20
    with mcap.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        topics = [channel.topic for _, channel, _ in reader.iter_messages()]
    assert topics.count("/camera/image") == topics.count("/slam/pose") == summary["keyframes"]
    assert topics.count("/slam/links") == topics.count("/slam/path") > 0


@pytest.mark.slow
def test_a_table_that_is_started_anew_ends_no_flight(recorded, tmp_path, monkeypatch):
    """The mosaic is drawn from the pictures that were mapped, not from those of the new table."""
    growing, out = tmp_path / "growing", tmp_path / "out"
    shutil.copytree(recorded, growing)
    table = growing / "mav0/cam0/data.csv"
    rows = table.read_text().splitlines(keepends=True)
    looks = []

    def started_anew(source):
        table.write_text("".join(rows[:21] if len(looks) < 2 else [rows[0], *rows[21:]]))
        looks.append(source)
        return read_flight(source)

    monkeypatch.setattr("slam.io.flight_folder.read_flight", started_anew)
    result = CliRunner().invoke(app, ["live", str(growing), "--out", str(out), "--follow", "5", "--json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["frames"] == len(rows) - 1
    assert (out / "mosaic.png").exists()
    assert any("20 pictures that were mapped are no longer in it" in line for line in summary["warnings"])


@pytest.mark.slow
def test_ctrl_c_ends_the_flight_and_its_map_is_made(recorded, tmp_path, monkeypatch, capfd):
    looks = []

    def interrupted(source):
        looks.append(source)
        if len(looks) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return read_flight(source)

    monkeypatch.setattr("slam.io.flight_folder.read_flight", interrupted)
    command = ["live", str(recorded), "--out", str(tmp_path / "out"), "--follow", "600", "--json"]
    result = CliRunner().invoke(app, [*command, "--no-mosaic"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["frames"] == 36
    assert "press Ctrl-C again to stop without a map" in capfd.readouterr().err


@pytest.mark.slow
def test_a_recording_is_replayed_at_its_pace(recorded, tmp_path):
    begin = time.perf_counter()
    result = CliRunner().invoke(app, ["live", str(recorded), "--out", str(tmp_path / "out"), "--speed", "2"])
    assert result.exit_code == 0, result.output
    assert time.perf_counter() - begin > 2.2  # of pictures over 4.4 s
    assert "In flight" in result.stdout


def test_what_cannot_be_flown_is_refused(recorded, tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["live", str(recorded), "--out", str(out), "--preview", "a.tif"])
    assert result.exit_code == 1
    assert "end the name with .png or .jpg" in result.stderr
    taken = recorded / "flight.yaml"
    result = CliRunner().invoke(app, ["live", str(recorded), "--out", str(out), "--mcap", str(taken)])
    assert result.exit_code == 1
    assert "exists already" in result.stderr
    write_flight(photographs([(flown(0), k) for k in (0, 10)]), tmp_path / "photos")
    result = CliRunner().invoke(app, ["live", str(tmp_path / "photos"), "--out", str(out)])
    assert result.exit_code == 1
    assert "use slam optimize" in result.stderr
    assert not out.exists()
