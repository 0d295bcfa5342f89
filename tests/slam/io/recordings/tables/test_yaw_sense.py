"""A yaw that is clockwise from north is told from one that is counter-clockwise from east."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import lines_with, table

TIME_S = np.arange(0, 40, 0.2)
YAW = 0.3 + np.radians(8) * TIME_S
"""Counter-clockwise from east, a turn to the left."""
HEADING_DEG = (90 - np.degrees(YAW)) % 360


def written(path, yaw_deg, **others):
    """Write a table with a column of yaw and others, whose names have the unit behind two underscores."""
    columns = {
        "time [s]": TIME_S,
        "roll [deg]": 0 * TIME_S,
        "pitch [deg]": 0 * TIME_S + 5,
        "yaw [deg]": yaw_deg,
    }
    columns |= {name.replace("__", " [") + "]" * ("__" in name): values for name, values in others.items()}
    rows = (",".join(f"{value:.8f}" for value in row) for row in zip(*columns.values(), strict=True))
    return table(path, ",".join(columns), *rows)


def track():
    """Return latitude and longitude of the flight in degrees, with noise of 0.3 m."""
    noise = np.random.default_rng(1).normal(0, 0.3, (2, len(TIME_S)))
    east, north = np.cumsum(2 * 0.2 * np.array([np.cos(YAW), np.sin(YAW)]), axis=1) + noise
    return {"latitude": 47 + north / 111_200, "longitude": 8 + east / 75_900}


@pytest.mark.parametrize("up", [1, -1])
def test_the_gyro_tells_the_sense(tmp_path, up):
    imu = {f"gyro_{axis}__rad/s": 0 * TIME_S for axis in "xy"} | {
        f"accel_{axis}__m/s^2": 0 * TIME_S for axis in "xy"
    }
    imu |= {"gyro_z__rad/s": 0 * TIME_S + up * np.radians(8), "accel_z__m/s^2": 0 * TIME_S + up * 9.8}
    flight = read(written(tmp_path / "a.csv", HEADING_DEG, **imu))
    assert np.unwrap(flight.attitude.roll_pitch_yaw_rad[:, 2]) == pytest.approx(YAW, abs=1e-6)
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0, 1]) == pytest.approx(-5)
    assert lines_with(flight, ["'yaw [deg]' is clockwise from north by the gyro; read as heading"])
    flight = read(written(tmp_path / "b.csv", np.degrees(YAW) % 360, **imu))
    assert np.unwrap(flight.attitude.roll_pitch_yaw_rad[:, 2]) == pytest.approx(YAW, abs=1e-6)
    assert lines_with(flight, ["counter-clockwise from east by the gyro"])


@pytest.mark.parametrize("has_velocity", [True, False])
def test_positions_tell_the_sense(tmp_path, has_velocity):
    speed = {"v_x__m/s": 0 * TIME_S + 2, "v_y__m/s": 0 * TIME_S} if has_velocity else {}
    flight = read(written(tmp_path / "a.csv", HEADING_DEG, **track(), **speed))
    assert np.unwrap(flight.attitude.roll_pitch_yaw_rad[:, 2]) == pytest.approx(YAW, abs=1e-6)
    flight = read(written(tmp_path / "b.csv", np.degrees(YAW) % 360, **track(), **speed))
    assert np.unwrap(flight.attitude.roll_pitch_yaw_rad[:, 2]) == pytest.approx(YAW, abs=1e-6)


@pytest.mark.parametrize("yaw_deg", [HEADING_DEG, 0 * TIME_S + 30])
def test_a_yaw_that_may_be_of_a_compass_is_refused(tmp_path, yaw_deg):
    path = written(tmp_path / "a.csv", yaw_deg)
    with pytest.raises(
        InputError, match="no other column tells its sense; name it heading if it is clockwise"
    ):
        read(path)
    text = path.read_text().replace("yaw [deg]", "yaw_from_east [deg]")
    path.write_text(text)
    assert np.degrees(read(path).attitude.roll_pitch_yaw_rad[0, 2]) % 360 == pytest.approx(yaw_deg[0])


def test_a_negative_yaw_is_taken_from_east_with_a_warning(tmp_path):
    flight = read(written(tmp_path / "a.csv", 20 * np.sin(TIME_S)))
    assert lines_with(flight, ["'yaw [deg]' is taken counter-clockwise from east; no other column tells"])


def test_positions_that_contradict_the_gyro_decide_nothing(tmp_path):
    turn = {"gyro_z__rad/s": 0 * TIME_S + np.radians(8)}
    speed = {"v_x__m/s": 0 * TIME_S + 2, "v_y__m/s": 0 * TIME_S}
    mirrored = {"latitude": 2 * 47 - track()["latitude"], "longitude": track()["longitude"]}
    path = written(tmp_path / "a.csv", np.degrees(-YAW) % 360, **mirrored, **turn, **speed)
    flight = read(path)
    assert flight.attitude is None
    assert lines_with(
        flight, ["attitude0 is taken on request", "gyro and the positions contradict each other"]
    )
    assert read(path, attitude0="a.csv").attitude is not None


def test_a_yaw_that_nobody_reads_is_not_judged(tmp_path):
    angles_deg = {"heading": 0, "pitch": -90, "roll": 0}
    gimbal = {f"gimbal_{name}__deg": 0 * TIME_S + value for name, value in angles_deg.items()}
    flight = read(written(tmp_path / "a.csv", HEADING_DEG, **gimbal))
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx([0, 0, 90], abs=1e-9)
    assert not lines_with(flight, ["yaw [deg]"])


@pytest.mark.parametrize("yaw_deg", [0, 90])
def test_a_straight_leg_that_may_be_flown_sideways_tells_nothing(tmp_path, yaw_deg):
    north = np.cumsum(0 * TIME_S + 0.4) + np.random.default_rng(2).normal(0, 0.3, len(TIME_S))
    place = {"latitude": 47 + north / 111_200, "longitude": 0 * TIME_S + 8}
    noise = np.random.default_rng(3).normal(0, 1, len(TIME_S))
    flight = read(written(tmp_path / "a.csv", (yaw_deg + noise + 180) % 360 - 180, **place))
    assert not lines_with(flight, ["by positions"])
    assert lines_with(flight, ["no other column tells its sense"]) or flight.attitude is None


@pytest.mark.parametrize("is_held", [True, False])
def test_a_slow_yaw_among_rows_of_a_fast_gyro_is_judged_by_its_changes(tmp_path, is_held):
    time_s = np.arange(0, 10, 0.005)
    heading_deg = 300 - 8 * time_s + 3 * np.sin(time_s)
    rate = np.radians(8 - 3 * np.cos(time_s))
    rows = []
    for k, each in enumerate(time_s):
        heading = f"{heading_deg[k - k % 20]:.4f}" if is_held or k % 20 == 0 else ""
        rows.append(f"{each:.3f},0,0,{heading},{rate[k]:.6f}")
    header = "time [s],roll [deg],pitch [deg],yaw [deg],gyro_z [rad/s]"
    flight = read(table(tmp_path / "a.csv", header, *rows))
    assert lines_with(flight, ["'yaw [deg]' is clockwise from north by the gyro"])
