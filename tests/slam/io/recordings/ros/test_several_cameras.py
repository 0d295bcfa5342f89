"""Bags of several cameras of which neither transforms nor names tell where they look: pictures do."""

from __future__ import annotations

import pytest
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_cameras import AHEAD, NADIR, MadeFlight, made_bag

ASKEW = Rotation.from_euler("y", 20, degrees=True).as_matrix() @ NADIR


def taken(flight: Flight) -> str:
    return next(source.channel for source in flight.sources if source.stream == "cam0")


def told(flight: Flight, channel: str) -> str:
    return next(source.reading for source in flight.sources if source.channel == channel)


def tilt_deg(reading: str) -> float:
    return float(reading.partition(" degrees")[0].rpartition(" ")[2])


@pytest.mark.slow
@pytest.mark.parametrize("mounts", [{"a": AHEAD, "b": NADIR}, {"a": NADIR, "b": AHEAD}])
@pytest.mark.parametrize("body", ["imu", "attitude"])
def test_the_camera_that_looks_down_is_found(tmp_path, mounts, body):
    flight = read(made_bag(tmp_path / "a.bag", mounts, body=body))
    down, ahead = ("b", "a") if mounts["b"] is NADIR else ("a", "b")
    assert taken(flight) == f"/{down}/image_raw"
    assert "looks down" in told(flight, f"/{down}/image_raw")
    left = told(flight, f"/{ahead}/image_raw")
    assert "looks aside" in left
    assert f"--topic cam0=/{ahead}/image_raw" in left
    assert not any("neither" in line for line in flight.warnings)


@pytest.mark.slow
def test_axes_of_the_imu_do_not_matter(tmp_path):
    turned = Rotation.random(random_state=1).as_matrix()
    flight = read(made_bag(tmp_path / "a.bag", {"a": AHEAD, "b": NADIR}, imu_R_b=turned))
    assert taken(flight) == "/b/image_raw"


@pytest.mark.slow
def test_both_look_down(tmp_path):
    flight = read(made_bag(tmp_path / "a.bag", {"a": NADIR, "b": ASKEW}))
    assert taken(flight) == "/a/image_raw"
    assert tilt_deg(told(flight, "/a/image_raw")) < 5
    assert tilt_deg(told(flight, "/b/image_raw")) == pytest.approx(20, abs=5)


@pytest.mark.slow
def test_both_look_ahead_and_it_is_said(tmp_path):
    flight = read(made_bag(tmp_path / "a.bag", {"a": AHEAD, "b": AHEAD}))
    assert all("looks aside" in told(flight, f"/{name}/image_raw") for name in "ab")
    (line,) = [line for line in flight.warnings if "by its pictures" in line]
    assert "degrees away from straight down" in line


@pytest.mark.slow
@pytest.mark.parametrize("flight", [MadeFlight(turns=0), MadeFlight(turns=0, moves=0)])
def test_a_vehicle_that_does_not_turn_tells_nothing(tmp_path, flight):
    found = read(made_bag(tmp_path / "a.bag", {"a": AHEAD, "b": NADIR}, flight))
    (line,) = [line for line in found.warnings if "--topic cam0=CHANNEL" in line]
    assert "which of /a/image_raw and /b/image_raw looks down" in line


@pytest.mark.slow
@pytest.mark.parametrize(("mount", "looks"), [(AHEAD, "aside"), (NADIR, "down")])
def test_a_single_camera_is_checked(tmp_path, mount, looks):
    flight = read(made_bag(tmp_path / "a.bag", {"a": mount}))
    assert f"looks {looks}" in told(flight, "/a/image_raw")
    assert any("by its pictures it looks" in line for line in flight.warnings) == (looks == "aside")


@pytest.mark.slow
@pytest.mark.parametrize(("quarter_turns", "side"), [(0, "nose"), (1, "left"), (2, "rear"), (-1, "right")])
def test_the_top_of_the_picture_is_found_to_a_quarter_turn(tmp_path, quarter_turns, side):
    """The mount is 12 degrees off a quarter turn."""
    exact = Rotation.from_euler("z", 90 * quarter_turns, degrees=True).as_matrix() @ NADIR
    mount = Rotation.from_euler("z", 12, degrees=True).as_matrix() @ exact
    flight = read(made_bag(tmp_path / "a.bag", {"a": mount}))
    assert flight.camera.b_T_c[:3, :3] == pytest.approx(exact, abs=1e-9)
    (line,) = [line for line in flight.warnings if line.startswith("cam0: no fixed transform to the body")]
    assert ("nose at the top assumed" in line) == (side == "nose")
    assert (f"at the {side} of the vehicle" in line) == (side != "nose")


@pytest.mark.slow
def test_without_instruments_the_axis_of_the_turns_tells(tmp_path):
    flight = read(made_bag(tmp_path / "a.bag", {"a": AHEAD, "b": NADIR}, MadeFlight(lasts_s=50), body=""))
    assert taken(flight) == "/b/image_raw"
    assert "looks down (or up)" in told(flight, "/b/image_raw")
    assert "looks aside" in told(flight, "/a/image_raw")
