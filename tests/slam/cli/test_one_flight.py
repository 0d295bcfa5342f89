"""Several sources on the command line, and the request that a map and its readers share."""

from __future__ import annotations

import shutil
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from slam.cli import app
from slam.cli.mapped import mapped_flight
from slam.cli.one_flight import offsets_of, open_one_flight
from slam.core.errors import InputError
from slam.core.progress import silent
from slam.io.flight_folder import write_flight
from slam.io.recordings.choice import Request
from tests.slam.io.made_flight import made_flight
from tests.slam.io.recordings.foxglove.made_mcap import json_records, mcap

START_NS = 1_700_000_000 * 10**9


@pytest.fixture
def recording(tmp_path):
    """A recording of two receivers of GPS."""
    rows = []
    for k in range(3):
        for topic, latitude in (("/front", 10.0), ("/rear", 20.0)):
            fix = {"timestamp": {"sec": START_NS // 10**9 + k, "nsec": 0}, "latitude": latitude}
            rows.append((topic, "LocationFix", START_NS + k * 10**9, fix))
    return mcap(tmp_path / "two.mcap", *json_records(rows))


@pytest.fixture
def folder(tmp_path):
    """A flight folder with IMU and pictures, without GPS."""
    write_flight(replace(made_flight(), gps=None), tmp_path / "flight")
    return tmp_path / "flight"


def test_a_stream_that_is_left_out_takes_its_camera_along(folder, recording):
    both = open_one_flight([folder, recording], silent, Request({"gps0": "/rear"}), {"gps0": 0.0})
    assert both.camera is not None
    assert set(both.gps.latitude_deg.tolist()) == {20.0}
    request = Request({"gps0": "/rear", "cam0": ""})
    alone = open_one_flight([folder, recording], silent, request, {"gps0": 0.0})
    assert (alone.camera, alone.frames) == (None, None)


def test_a_picture_rate_without_a_recording_is_refused(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "second")
    with pytest.raises(InputError, match="--picture-rate: no source is a recording"):
        open_one_flight([folder, tmp_path / "second"], silent, Request({}, 2.0), {})


@pytest.mark.parametrize("text", ["cam0", "cam0=", "cam0=x", "cam0=nan", "cam0=inf", "cam0=1e10", "eye=1"])
def test_an_offset_that_is_no_number_of_seconds_is_refused(text):
    with pytest.raises(InputError, match="is not of the form STREAM=SECONDS"):
        offsets_of([text])


def test_two_offsets_of_one_stream_are_refused():
    assert offsets_of(["cam0=1.5", "imu0=-2"]) == {"cam0": 1.5, "imu0": -2.0}
    with pytest.raises(InputError, match="cam0 is given twice"):
        offsets_of(["cam0=1", "cam0=2"])


def test_a_taken_output_is_refused_before_the_clocks_are_aligned(tmp_path, recording):
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "mine.txt").touch()
    arguments = ["import", str(recording), str(tmp_path / "missing.ulg"), "--out", str(taken)]
    said = CliRunner().invoke(app, arguments).stderr
    assert "taken: exists already and is not empty" in said, "not that the second source is missing"


@pytest.mark.parametrize(("channel", "latitude_deg"), [("/front", 10.0), ("/rear", 20.0)])
def test_the_flight_of_a_map_is_read_by_the_request_of_the_map(tmp_path, recording, channel, latitude_deg):
    flight = mapped_flight(tmp_path, [recording], Request({"gps0": channel}))
    assert set(flight.gps.latitude_deg.tolist()) == {latitude_deg}


@pytest.mark.parametrize(
    "command",
    [["evaluate", "map", "--truth", "a"], ["locate", "p", "--map", "map", "--flight", "a", "--out", "o"]],
)
def test_commands_that_read_a_map_take_the_request(command):
    said = CliRunner().invoke(app, [*command, "--topic", "gps0"]).stderr
    assert "--topic gps0: is not of the form STREAM=CHANNEL" in said
