"""PX4's messages in ROS 2 bags: axes, units, stamps and versions, with values worked out by hand."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import HALF, START_NS, Maker, write

STAMP = "uint64 timestamp\n"
DEFINITIONS = {
    "SensorCombined": "float32[3] gyro_rad\nfloat32[3] accelerometer_m_s2",
    "VehicleAttitude": "float32[4] q\nuint8 quat_reset_counter",
    "SensorGps": "float64 latitude_deg\nfloat64 longitude_deg\nfloat64 altitude_msl_m\nuint8 fix_type",
    "VehicleGpsPosition": "int32 lat\nint32 lon\nint32 alt\nuint8 fix_type",
    "DistanceSensor": (
        "float32 min_distance\nfloat32 max_distance\nfloat32 current_distance\nfloat32 variance\n"
        "int8 signal_quality\nuint8 orientation"
    ),
    "VehicleOdometry": (
        "uint8 pose_frame\nfloat32[3] position\nfloat32[4] q\nuint8 velocity_frame\nfloat32[3] velocity"
    ),
}
NORTH_LEVEL, EAST_LEVEL = (1.0, 0.0, 0.0, 0.0), (HALF, 0.0, 0.0, HALF)
"""Forward-right-down axes in north-east-down: the nose to the north, and to the east."""


def maker() -> Maker:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(STAMP + text, f"px4_msgs/msg/{name}"))
    return Maker(store)


M = maker()


def message(name: str, stamp_us: int, **fields):
    values = {key: np.array(v, np.float32) if isinstance(v, tuple) else v for key, v in fields.items()}
    return M.make(f"px4_msgs/msg/{name}", timestamp=stamp_us, **values)


def bag(path: Path, topic: str, *messages, mcap: bool = True) -> Path:
    return write(
        path, M, [(f"/fmu/out/{topic}", START_NS + 10**7 * k, m) for k, m in enumerate(messages)], mcap
    )


@pytest.mark.parametrize("mcap", [False, True])
def test_gyro_and_accelerometer_become_forward_left_up_on_px4s_clock(tmp_path, mcap):
    rows = [
        message(
            "SensorCombined",
            5_000_000 + 4000 * k,
            gyro_rad=(0.5, 0.25, 0.125),
            accelerometer_m_s2=(1.0, 2.0, -9.5),
        )
        for k in range(3)
    ]
    flight = read(bag(tmp_path / "a", "sensor_combined", *rows, mcap=mcap))
    assert flight.imu.gyro_rad_s[0].tolist() == [0.5, -0.25, -0.125]
    assert flight.imu.accel_m_s2[0].tolist() == [1.0, -2.0, 9.5]
    assert flight.epoch_ns == 5 * 10**9, "microseconds of the autopilot, not the time of recording"
    assert flight.imu.stamps_s == pytest.approx([0.0, 0.004, 0.008], abs=1e-12)


def test_an_attitude_to_the_east_has_yaw_zero(tmp_path):
    rows = [
        message("VehicleAttitude", 10**6 * k, q=q, quat_reset_counter=0)
        for k, q in enumerate((EAST_LEVEL, NORTH_LEVEL, (np.cos(0.1), 0.0, np.sin(0.1), 0.0)), 1)
    ]
    angles = read(bag(tmp_path / "a", "vehicle_attitude", *rows)).attitude.roll_pitch_yaw_rad
    assert angles[0] == pytest.approx([0, 0, 0], abs=1e-6)
    assert angles[1] == pytest.approx([0, 0, np.pi / 2], abs=1e-6)
    assert angles[2] == pytest.approx([0, -0.2, np.pi / 2], abs=1e-6), "the nose up is a negative pitch"


def test_positions_of_both_versions(tmp_path):
    fixes = [(47.25, 8.5, 410.125, fix) for fix in (3, 2, 0)]
    now = [
        message("SensorGps", 10**6 * (k + 1), latitude_deg=a, longitude_deg=b, altitude_msl_m=c, fix_type=f)
        for k, (a, b, c, f) in enumerate(fixes)
    ]
    before = [
        message(
            "VehicleGpsPosition", 10**6 * (k + 1), lat=472_500_000, lon=85_000_000, alt=410_125, fix_type=f
        )
        for k, (*_, f) in enumerate(fixes)
    ]
    for name, rows in (("now", now), ("before", before)):
        gps = read(bag(tmp_path / name, "vehicle_gps_position", *rows)).gps
        assert gps.latitude_deg == pytest.approx([47.25, 47.25], abs=1e-9)
        assert gps.longitude_deg == pytest.approx([8.5, 8.5], abs=1e-9)
        assert gps.altitude_m[0] == pytest.approx(410.125)
        assert np.isnan(gps.altitude_m[1]), "a fix of two dimensions"


def test_only_ranges_to_the_ground_are_taken(tmp_path):
    rows = [
        message(
            "DistanceSensor",
            10**6 * (k + 1),
            min_distance=0.25,
            max_distance=30.0,
            current_distance=distance,
            variance=0.25,
            signal_quality=quality,
            orientation=orientation,
        )
        for k, (distance, quality, orientation) in enumerate(
            [(1.5, 100, 25), (1.5, 0, 25), (1.5, -1, 0), (40.0, -1, 25), (2.5, -1, 25)]
        )
    ]
    flight = read(bag(tmp_path / "a", "distance_sensor", *rows))
    assert np.array_equal(flight.sonar.range_m, [1.5, np.nan, np.nan, np.nan, 2.5], equal_nan=True)
    assert (flight.sonar.min_range_m, flight.sonar.max_range_m) == (0.25, 30.0)
    assert flight.sonar.noise_std_m == 0.5
    assert any("1 reading of sensors that do not look down" in line for line in flight.warnings)


def odometry(frame: int, velocity_frame: int, velocity: tuple, stamp_us: int = 10**6):
    return message(
        "VehicleOdometry",
        stamp_us,
        pose_frame=frame,
        position=(1.0, 2.0, -3.0),
        q=EAST_LEVEL,
        velocity_frame=velocity_frame,
        velocity=velocity,
    )


def test_odometry_is_an_attitude_and_on_request_a_velocity(tmp_path):
    """The nose points east: north is to the left. An unknown frame of the velocity gives none."""
    rows = [
        odometry(1, 1, (0.25, 0.5, 0.0), 10**6),
        odometry(1, 3, (0.5, -0.25, 0.0), 2 * 10**6),
        odometry(1, 0, (9.0, 9.0, 9.0), 3 * 10**6),
    ]
    path = bag(tmp_path / "a", "vehicle_odometry", *rows)
    flight = read(path)
    assert flight.attitude.roll_pitch_yaw_rad[0] == pytest.approx([0, 0, 0], abs=1e-6)
    assert (flight.velocity, flight.truth) == (None, None)
    flight = read(path, velocity0="/fmu/out/vehicle_odometry")
    assert flight.velocity.v_m_s[:2] == pytest.approx(np.array([[0.5, 0.25], [0.5, 0.25]]), abs=1e-6)
    assert np.isnan(flight.velocity.v_m_s[2:]).all()


def test_odometry_of_a_motion_capture_is_the_truth(tmp_path):
    rows = [odometry(1, 1, (0.0, 0.0, 0.0), 10**6), odometry(0, 0, (0.0, 0.0, 0.0), 2 * 10**6)]
    flight = read(bag(tmp_path / "a", "vehicle_mocap_odometry", *rows))
    assert flight.attitude is None
    assert flight.truth.w_T_b[0, :3, 3] == pytest.approx([2.0, 1.0, 3.0]), "east, north, up"
    assert flight.truth.w_T_b[0, :3, :3] == pytest.approx(np.eye(3), abs=1e-6)
    assert len(flight.truth.stamps_s) == 1, "the second one is in no known frame"


def test_a_bag_without_the_definitions_says_so(tmp_path):
    """Before Iron, sqlite3 bags hold no definitions."""
    imu = ("/imu", START_NS, M.imu(M.header(START_NS, "base_link"), (0.1, 0.2, 0.3), (0.0, 0.0, 9.75)))
    q = message("VehicleAttitude", 10**6, q=EAST_LEVEL, quat_reset_counter=0)
    path = write(tmp_path / "a", M, [imu, ("/fmu/out/vehicle_attitude", START_NS, q)])
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("delete from message_definitions")
    flight = read(path)
    assert flight.attitude is None
    assert len(flight.imu.stamps_s) == 1
    assert any("lacks the definitions of PX4's messages" in line for line in flight.warnings)
