"""An attitude that leans against the floor: told, and taken for the mount where two instruments say so."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam import optimize
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries
from slam.evaluation import evaluate
from slam.mapping.calibration.attitude_floor_tilt import attitude_floor_tilt, attitude_floor_tilt_warning
from tests.slam.small_flight import flown

ASKEW_RAD = np.array([0.05, -0.035])
TURNING = {"heading": "along_path"}


def askew(flight: Flight, turn_rad: np.ndarray = ASKEW_RAD) -> Flight:
    """The flight, told of a mount that is turned by this about the body's x and y."""
    b_T_c = flight.camera.b_T_c.copy()
    # What is told is the true mount turned back.
    b_T_c[:3, :3] = Rotation.from_rotvec([*turn_rad, 0.0]).inv().as_matrix() @ b_T_c[:3, :3]
    return replace(flight, camera=replace(flight.camera, b_T_c=b_T_c))


@pytest.fixture(scope="module")
def turning():
    return flown(3, maneuver=TURNING)


@pytest.fixture(scope="module")
def mended(turning):
    return optimize(askew(turning))


@pytest.mark.slow
def test_a_mount_that_two_instruments_say_leans_is_found_and_taken_out(turning, mended):
    found = mended.instruments.mount
    assert np.abs(np.array(found.tilt_rad) - ASKEW_RAD).max() < 4 * found.std_rad < 0.005
    assert np.array(found.b_T_c) == pytest.approx(turning.camera.b_T_c, abs=4 * found.std_rad)
    assert mended.camera.b_T_c == pytest.approx(np.array(found.b_T_c))
    run = evaluate(mended, turning)
    assert run.ate_m.rmse < 0.004
    # 40 000 with the mount as told.
    assert run.nees.pose.mean < 8
    # Landmarks are seen by the camera as it is, not as it was told: 5 cm beside.
    assert max(row.error_m.loops for row in evaluate(mended, askew(turning)).landmarks) < 0.004
    (told,) = [w for w in mended.warnings if "askew" in w]
    assert f"{np.degrees(np.linalg.norm(ASKEW_RAD)):.1f}" in told


@pytest.mark.slow
def test_the_mount_that_is_written_for_other_programs_is_right(turning, mended):
    """Written back, nothing leans any more."""
    (told,) = [w for w in mended.warnings if "askew" in w]
    rows = [float(x) for x in re.search(r"\[(.*)\]", told)[1].split(",")]
    again = optimize(replace(turning, camera=replace(turning.camera, b_T_c=np.array(rows).reshape(4, 4))))
    assert again.instruments.mount is None
    assert not any("askew" in w or "is tilted by" in w for w in again.warnings)


@pytest.mark.slow
def test_an_attitude_s_own_zero_is_not_taken_for_the_mount(turning):
    """The accelerometer does not bear it out."""
    series = turning.attitude
    angles = series.roll_pitch_yaw_rad + [*ASKEW_RAD, 0.0]
    estimate = optimize(replace(turning, attitude=replace(series, roll_pitch_yaw_rad=angles)))
    assert estimate.instruments.mount is None
    assert any("attitude0 is tilted by" in w and "one side of the body" in w for w in estimate.warnings)


@pytest.mark.slow
def test_under_one_heading_the_mount_is_held_and_named():
    """Ground that slopes would look the same."""
    estimate = optimize(askew(flown(3)))
    assert estimate.instruments.mount is None
    assert any(
        "the ground slopes, or the camera's mounting (T_BS) or the attitude is off" in w
        for w in estimate.warnings
    )


@pytest.mark.slow
def test_a_mount_stated_as_uncertain_is_estimated_whatever_it_is(turning):
    tilt_rad = np.array([0.004, 0.002])
    flight = askew(turning, tilt_rad)
    uncertain = replace(flight, camera=replace(flight.camera, mount_std_rad=0.02))
    found = optimize(uncertain).instruments.mount
    assert np.abs(np.array(found.tilt_rad) - tilt_rad).max() < 4 * found.std_rad < 0.005


def leaning(of_ground_rad: float, of_mount_rad: float, turns_rad: float) -> str:
    """What is told of a vehicle that turns over ground rising along x, its attitude's zero off in roll."""
    rng = np.random.default_rng(0)
    stamps_s = np.linspace(0, 20, 201)
    heading = turns_rad * stamps_s / 20
    sway = rng.normal(0, 0.01, (201, 2))
    over_floor = Rotation.from_euler("ZYX", np.column_stack([heading, sway]))
    upright = Rotation.from_euler("y", -of_ground_rad) * over_floor
    angles = upright.as_euler("ZYX")[:, ::-1] + [of_mount_rad, 0, 0] + rng.normal(0, 0.005, (201, 3))
    poses = np.tile(np.eye(4), (201, 1, 1))
    poses[:, :3, :3] = over_floor.as_matrix()
    flight = Flight("made", attitude=AttitudeSeries(stamps_s, angles))
    return str(attitude_floor_tilt_warning(attitude_floor_tilt(flight, stamps_s, poses)) or "")


def test_ground_that_slopes_is_reported_and_from_what():
    told = leaning(0.06, 0.0, 6.0)
    size_deg, uphill_deg = (float(n) for n in re.findall(r"([-+]?[\d.]+)°", told))
    assert size_deg == pytest.approx(np.degrees(0.06), abs=0.1)
    assert abs(uphill_deg) < 3
    assert "the ground slopes" in told
    assert "one side of the body" in leaning(0.0, 0.06, 6.0)
    # Under one heading nothing tells them apart.
    assert "the ground slopes, or the camera's mounting (T_BS) or the attitude is off" in leaning(
        0.06, 0.0, 0.0
    )
    assert leaning(0.01, 0.01, 6.0) == ""
