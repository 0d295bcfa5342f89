"""PX4 logs: units and axes against values worked out by hand, and the choice of channels."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from slam.core.errors import InputError
from slam.core.rotations import rotation_of
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.recordings.logs.made_ulog import log, message
from tests.slam.io.recordings.read_recording import read

IMU = "float[3] gyro_rad;float[3] accelerometer_m_s2;"
SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings" / "ulog"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")


def imu_rows(count: int = 5) -> list[tuple]:
    """Level and at rest in forward-right-down axes, turning right; 250 Hz."""
    return [(1_000_000 + 4000 * k, 0.5, 0.25, 0.125, 1.0, 2.0, -9.75) for k in range(count)]


def test_forward_right_down_becomes_forward_left_up(tmp_path):
    flight = read(log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", imu_rows())}))
    assert flight.imu.gyro_rad_s[0].tolist() == [0.5, -0.25, -0.125]
    assert flight.imu.accel_m_s2[0].tolist() == [1.0, -2.0, 9.75]
    assert flight.epoch_ns == 1_000_000_000, "microseconds since the start of the autopilot"
    assert np.allclose(np.diff(flight.imu.stamps_s), 0.004, atol=1e-12)
    assert flight.notes["vehicle"] == "PX4"


@pytest.mark.parametrize(
    ("roll_pitch_heading_deg", "expected_deg"),
    [
        ((0, 0, 0), (0, 0, 90)),  # north
        ((0, 0, 90), (0, 0, 0)),  # east
        ((0, 0, 180), (0, 0, -90)),
        ((10, 0, 90), (10, 0, 0)),  # right wing down in both
        ((0, 20, 0), (0, -20, 90)),  # nose up
        ((10, 20, 30), (10, -20, 60)),
    ],
)
def test_attitude_of_north_east_down_becomes_yaw_from_east(tmp_path, roll_pitch_heading_deg, expected_deg):
    roll, pitch, heading = (math.radians(a) / 2 for a in roll_pitch_heading_deg)
    (cr, sr), (cp, sp), (ch, sh) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, heading))
    q = (  # Rz(heading) Ry(pitch) Rx(roll), w first
        cr * cp * ch + sr * sp * sh,
        sr * cp * ch - cr * sp * sh,
        cr * sp * ch + sr * cp * sh,
        cr * cp * sh - sr * sp * ch,
    )
    rows = [(1_000_000 + 10_000 * k, *q) for k in range(4)]
    flight = read(log(tmp_path / "a.ulg", {"vehicle_attitude": ("float[4] q;", "4f", rows)}))
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx(expected_deg, abs=1e-4)


def test_a_receiver_states_its_accuracy(tmp_path):
    fields = "int32_t lat;int32_t lon;int32_t alt;uint8_t fix_type;float eph;float epv;"
    rows = [(1_000_000 + 200_000 * k, 600_000_000, 80_000_000, 500_000, 3, 0.02, 0.04) for k in range(3)]
    rows += [(2_000_000 + 200_000 * k, 0, 0, 0, 0, 99.0, 99.0) for k in range(9)]
    gps = read(log(tmp_path / "a.ulg", {"vehicle_gps_position": (fields, "3iB2f", rows)})).gps
    assert gps.noise_std_m == pytest.approx((0.02, 0.02, 0.04), rel=1e-5)


def test_the_range_sensor_that_looks_down_is_taken(tmp_path):
    """The limits of the second one are left 0, which states none."""
    fields = "float min_distance;float max_distance;float current_distance;uint8_t orientation;"
    topics = {
        f"distance_sensor{name}": (
            fields,
            "3fB",
            [(1_000_000 + k, 0.0, 0.0, 50.0, facing) for k in range(3)],
        )
        for name, facing in (("", 0), ("[1]", 25))
    }
    flight = read(log(tmp_path / "a.ulg", topics))
    assert flight.sonar.range_m.tolist() == [50.0] * 3
    left = next(s for s in flight.sources if s.channel == "distance_sensor")
    assert "3 readings of sensors that do not look down are left out" in left.reading


def test_flow_of_older_versions(tmp_path):
    """0.03 rad less 0.01 rad of turn in 0.02 s at 2 m: 2 m/s forward."""
    names = ["pixel_flow_x", "pixel_flow_y", "gyro_x_rate", "gyro_y_rate"]
    fields = "".join(f"float {name}_integral;" for name in names)
    fields += "float ground_distance_m;uint32_t integration_timespan;uint8_t quality;"
    rows = [(1_000_000, 0, 0.03, 0, 0.01, 2.0, 20_000, 200), (1_020_000, 0, 0.03, 0, 0.01, 2.0, 20_000, 0)]
    velocity = read(log(tmp_path / "a.ulg", {"optical_flow": (fields, "5fIB", rows)})).velocity
    assert velocity.v_m_s[0] == pytest.approx([2.0, 0.0], abs=1e-6)
    assert np.isnan(velocity.v_m_s[1]).all()


def test_integer_positions_are_scaled_and_fixes_are_required(tmp_path):
    fields = "int32_t lat;int32_t lon;int32_t alt;uint8_t fix_type;"
    rows = [
        (1_000_000, 473_977_418, 85_455_939, 488_123, 3),
        (1_200_000, 473_977_419, 85_455_940, 488_124, 2),
        (1_400_000, 473_977_420, 85_455_941, 488_125, 1),
    ]
    flight = read(log(tmp_path / "a.ulg", {"vehicle_gps_position": (fields, "3iB", rows)}))
    assert flight.gps.latitude_deg == pytest.approx([47.3977418, 47.3977419], abs=1e-9)
    assert flight.gps.longitude_deg == pytest.approx([8.5455939, 8.5455940], abs=1e-9)
    assert flight.gps.altitude_m[0] == pytest.approx(488.123, abs=1e-9)
    assert np.isnan(flight.gps.altitude_m[1]), "a fix of two dimensions has no altitude"
    assert "gps0: 1 of 3 rows dropped: no position" in flight.warnings
    assert flight.gps.height_system == "EPSG:5773", "sea level by EGM96"


def test_newer_positions_are_in_degrees(tmp_path):
    fields = "double latitude_deg;double longitude_deg;double altitude_msl_m;uint8_t fix_type;"
    rows = [(1_000_000, 47.5, 8.25, 488.0, 3)]
    flight = read(log(tmp_path / "a.ulg", {"vehicle_gps_position": (fields, "3dB", rows)}))
    assert (flight.gps.latitude_deg[0], flight.gps.altitude_m[0]) == (47.5, 488.0)


def test_only_ranges_that_look_down_and_are_in_range_are_taken(tmp_path):
    fields = (
        "float min_distance;float max_distance;float current_distance;float variance;uint8_t orientation;"
    )
    rows = [
        (1_000_000, 0.25, 8.0, 1.5, 0.0625, 25),
        (1_100_000, 0.25, 8.0, 0.125, 0.0625, 25),  # too near
        (1_200_000, 0.25, 8.0, 1.75, 0.0625, 0),  # forward
    ]
    flight = read(log(tmp_path / "a.ulg", {"distance_sensor": (fields, "4fB", rows)}))
    assert flight.sonar.range_m[0] == 1.5
    assert np.isnan(flight.sonar.range_m[1:]).all()
    assert (flight.sonar.min_range_m, flight.sonar.max_range_m, flight.sonar.noise_std_m) == (0.25, 8.0, 0.25)
    assert any("do not look down" in line for line in flight.warnings)


def test_flow_times_distance_is_the_speed_over_the_ground(tmp_path):
    """Two metres above ground: 0.02 rad a 20 ms about y is 2 m/s forward, and about x 2 m/s to the left.

    A turn alone, flow equal to the gyro's angle, is no speed.
    """
    fields = (
        "float[2] pixel_flow;float[3] delta_angle;float distance_m;uint32_t integration_timespan_us;"
        "uint8_t quality;"
    )
    rows = [
        (1_000_000, 0.0, 0.02, 0.0, 0.0, 0.0, 2.0, 20_000, 200),
        (1_020_000, 0.02, 0.0, 0.0, 0.0, 0.0, 2.0, 20_000, 200),
        (1_040_000, 0.03, 0.04, 0.03, 0.04, 0.1, 2.0, 20_000, 200),
        (1_060_000, 0.0, 0.02, 0.0, 0.0, 0.0, 2.0, 20_000, 0),
    ]
    flight = read(log(tmp_path / "a.ulg", {"vehicle_optical_flow": (fields, "2f3ffIB", rows)}))
    assert flight.velocity.v_m_s[:3] == pytest.approx(np.array([[2, 0], [0, 2], [0, 0]]), abs=1e-6)
    assert np.isnan(flight.velocity.v_m_s[3]).all(), "a quality of zero is no reading"


@pytest.mark.parametrize(
    ("fields", "row", "expected"),
    [
        ("float x;float y;float z;float r;", (0.5, 0.25, 0.75, -0.125), (0.5, -0.25, 0.5, 0.125)),
        (
            "float pitch;float roll;float throttle;float yaw;",
            (0.5, 0.25, 0.75, -0.125),
            (0.5, -0.25, 0.75, 0.125),
        ),
    ],
    ids=["before 1.14", "since 1.14"],
)  # fmt: skip
def test_sticks_of_both_generations(tmp_path, fields, row, expected):
    flight = read(log(tmp_path / "a.ulg", {"manual_control_setpoint": (fields, "4f", [(1_000_000, *row)])}))
    assert flight.command.stick[0].tolist() == list(expected)


def batteries(path: Path) -> Path:
    volts = {
        f"battery_status{n}": ("float voltage_v;", "f", [(1_000_000, v)])
        for n, v in (("", 11.5), ("[1]", 15.5))
    }
    return log(path, {**volts, "cpuload": ("float load;", "f", [(1_000_000, 0.5)])})


def test_one_channel_is_taken_and_the_others_are_named(tmp_path):
    flight = read(batteries(tmp_path / "a.ulg"))
    assert flight.battery.value.tolist() == [11.5]
    left = {source.channel: source.reading for source in flight.sources if not source.stream}
    assert set(left) == {"battery_status[1]", "cpuload"}
    assert "--topic battery0=battery_status[1]" in left["battery_status[1]"]


def test_a_named_channel_is_taken(tmp_path):
    assert read(batteries(tmp_path / "a.ulg"), battery0="battery_status[1]").battery.value.tolist() == [15.5]
    with pytest.raises(
        InputError, match=r"no channel cpuload that can be battery0; channels that can: battery"
    ):
        read(batteries(tmp_path / "a.ulg"), battery0="cpuload")
    with pytest.raises(InputError, match="did you mean battery0"):
        read(batteries(tmp_path / "a.ulg"), baterry0="battery_status")


def test_a_log_without_instruments_names_what_it_holds(tmp_path):
    path = log(tmp_path / "a.ulg", {"cpuload": ("float load;", "f", [(1_000_000, 0.5)])})
    with pytest.raises(InputError, match=r"a PX4 log without a stream of a flight \(found: cpuload"):
        read(path)


def test_an_import_says_in_its_files_where_each_stream_is_from(tmp_path):
    flight = read(log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", imu_rows())}))
    write_flight(flight, tmp_path / "flight")
    again = read_flight(tmp_path / "flight")
    assert np.array_equal(again.imu.gyro_rad_s, flight.imu.gyro_rad_s)
    assert (again.epoch_ns, again.warnings) == (flight.epoch_ns, flight.warnings)
    sensor = yaml.safe_load((tmp_path / "flight/mav0/imu0/sensor.yaml").read_text(encoding="utf-8"))
    assert sensor["comment"].startswith("sensor_combined (sensor_combined): rad/s, m/s²; forward-right-down")


def test_a_value_that_no_sensor_gives_is_missing(tmp_path):
    rows = imu_rows(20)
    rows[7] = (rows[7][0], 1e30, *rows[7][2:])
    flight = read(log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", rows)}))
    assert len(flight.imu.stamps_s) == 19
    assert any("treated as missing (first: message 8)" in line for line in flight.warnings)


def test_a_message_that_was_never_published_is_left_out(tmp_path):
    rows = [(0, *imu_rows()[0][1:]), *imu_rows()]
    flight = read(log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", rows)}))
    assert flight.imu.stamps_s == pytest.approx(0.004 * np.arange(5))


def test_resets_of_the_autopilots_filter_are_told(tmp_path):
    rows = [(1_000_000 + 4000 * k, 1.0, 0.0, 0.0, 0.0, (0, 0, 1, 1, 2)[k]) for k in range(5)]
    fields = "float[4] q;uint8_t quat_reset_counter;"
    flight = read(log(tmp_path / "a.ulg", {"vehicle_attitude": (fields, "4fB", rows)}))
    assert any("reset its attitude 2 times" in line for line in flight.warnings)


def test_losses_of_the_logger_are_reported(tmp_path):
    dropout = message(b"O", (120).to_bytes(2, "little"))
    flight = read(log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", imu_rows())}, tail=dropout))
    assert "the logger lost data 1 time, 0.12 s in all; use a faster card, or log less" in flight.warnings


def test_a_truncated_log_gives_what_it_has(tmp_path):
    path = log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", imu_rows(50))})
    assert not any("cut short" in line for line in read(path).warnings)
    path.write_bytes(path.read_bytes()[:-50])
    flight = read(path)
    assert len(flight.imu.stamps_s) == 48
    assert any("ends within a message: it was cut short" in line for line in flight.warnings)


@pytest.mark.parametrize("content", [b"", b"hello", b"ULog\x01\x12\x35"])
def test_a_damaged_log_is_one_line(tmp_path, content):
    (tmp_path / "a.ulg").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.ulg: (is empty|has the name of a PX4 log|is a PX4 log)"):
        read(tmp_path / "a.ulg")


def test_a_missing_reader_is_one_line_with_the_command(tmp_path, monkeypatch):
    path = log(tmp_path / "a.ulg", {"sensor_combined": (IMU, "6f", imu_rows())})
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(
        InputError, match=r"pyulog .* not installed; run: pip install 'lemniscate-slam\[px4\]'"
    ):
        read(path)


@measured
@pytest.mark.parametrize(
    ("name", "vehicle", "streams"),
    [
        ("sample", "PX4 AUAV_X21", set()),
        ("sample_log_small", "PX4 CUBEPILOT_CUBEORANGE", {"gps", "command", "battery"}),
        ("sample_px4_events", "PX4 PX4_SITL", {"gps", "battery", "motor"}),
    ],
)  # fmt: skip
def test_recorded_logs(name, vehicle, streams):
    flight = read(SAMPLES / f"{name}.ulg")
    assert {field for field in ("imu", "attitude", "barometer", "gps", "command", "battery", "motor", "sonar")
            if getattr(flight, field) is not None} == {"imu", "attitude", "barometer", *streams}  # fmt: skip
    assert flight.notes["vehicle"] == vehicle


@measured
def test_attitude_and_accelerometer_of_a_vehicle_at_rest_agree():
    """Independent of PX4's conventions: the specific force at rest points up in the world."""
    flight = read(SAMPLES / "sample_log_small.ulg")
    w_R_b = rotation_of(np.median(flight.attitude.roll_pitch_yaw_rad, axis=0))
    up = w_R_b @ np.median(flight.imu.accel_m_s2, axis=0)
    assert up / np.linalg.norm(up) == pytest.approx([0, 0, 1], abs=0.02)
