"""ROS bags: the three containers, mounts from /tf_static, and values worked out by hand."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from frontend.camera import NADIR_B_T_C
from slam.core.errors import InputError
from slam.core.progress import silent
from slam.io.flight_folder import read_flight, write_flight
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import (
    HALF,
    ROS1,
    ROS2,
    START_NS,
    Maker,
    a_flight,
    at,
    picture,
    png,
    ros1,
    write,
)

SAMPLES = Path(os.environ.get("SLAM_DATA", "")) / "recordings"
measured = pytest.mark.skipif("SLAM_DATA" not in os.environ, reason="SLAM_DATA is not set")
M, M2 = Maker(ROS1), Maker(ROS2)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_three_containers_give_the_same_flight_folder(tmp_path):
    bags = [
        write(tmp_path / "bag.bag", Maker(ROS1), a_flight(Maker(ROS1))),
        write(tmp_path / "a/bag", Maker(ROS2), a_flight(Maker(ROS2)))
        if (tmp_path / "a").mkdir() is None
        else None,
        write(tmp_path / "b/bag", Maker(ROS2), a_flight(Maker(ROS2)), mcap=True)
        if (tmp_path / "b").mkdir() is None
        else None,
    ]
    folders = []
    for k, bag in enumerate(bags):
        write_flight(read(bag), tmp_path / f"flight{k}")
        folders.append(bytes_of(tmp_path / f"flight{k}"))
    assert folders[0] == folders[1] == folders[2]
    assert folders[0][f"mav0/cam0/data/{at(2)}.png"] == png(2), "pictures are written as the bag holds them"
    assert read_flight(tmp_path / "flight0").warnings[0].startswith("cam0: no fixed transform")


def test_stamps_values_and_mounts(tmp_path):
    flight = read(ros1(tmp_path / "a.bag", a_flight(M)))
    assert flight.epoch_ns == START_NS, "stamps of the headers, not of the recorder"
    assert flight.imu.gyro_rad_s[0].tolist() == [0.1, 0.2, 0.3]
    assert flight.imu.accel_m_s2[0].tolist() == [0.5, 0.25, 9.75]
    assert flight.attitude is None, "orientation_covariance[0] is -1"
    assert flight.sonar.range_m[0] == 1.5
    assert np.isnan(flight.sonar.range_m[1:3]).all(), "below min_range, and infinite"
    assert (flight.sonar.min_range_m, flight.sonar.max_range_m, flight.sonar.beam_width_rad) == (
        0.25,
        4.0,
        0.5,
    )
    beam = flight.sonar.b_T_s[:3, :3] @ [0, 0, -1]
    assert beam == pytest.approx([0, 0, -1], abs=1e-9)
    assert flight.sonar.b_T_s[:3, 3] == pytest.approx([0.1, 0.0, -0.05])
    assert (flight.camera.focal_px, flight.camera.center_px) == ((5.0, 5.0), (2.5, 1.5))
    assert np.array_equal(flight.camera.b_T_c, NADIR_B_T_C)


def test_the_camera_that_looks_down_is_taken(tmp_path):
    """Two cameras; of an optical frame that looks down, z is the body's -z: half a turn about x."""
    frames = M.transforms(
        ("base_link", "front", (0.0, 0.0, 0.0), (0.5, -0.5, 0.5, -0.5)),  # z forward, x right
        ("base_link", "belly", (0.0, 0.0, 0.0), (0.0, HALF, -HALF, 0.0)),  # z down, x right, nose at the top
    )
    messages = [("/tf_static", START_NS, frames)]
    for name in ("front", "belly"):
        header = M.header(at(0), name)
        messages += [
            (f"/{name}/image_raw", at(0), M.image(header, picture(1), "bgr8")),
            (f"/{name}/camera_info", at(0), M.info(header, 5.0)),
        ]
    path = ros1(tmp_path / "a.bag", messages)
    flight = read(path)
    assert flight.sources[0].channel == "/belly/image_raw"
    assert flight.camera.b_T_c == pytest.approx(NADIR_B_T_C, abs=1e-9)
    assert any(s.channel == "/front/image_raw" and "--topic cam0=" in s.reading for s in flight.sources)
    assert any("looks 90 degrees away" in line for line in read(path, cam0="/front/image_raw").warnings)


def test_without_transforms_names_say_where_cameras_and_ranges_look(tmp_path):
    messages = []
    for name in ("front", "bottom"):
        header = M.header(at(0), name)
        messages += [
            (f"/drone/{name}/image_raw", at(0), M.image(header, picture(1), "bgr8")),
            (f"/drone/{name}/camera_info", at(0), M.info(header, 5.0)),
        ]
    messages += [("/range_front", at(0), M.range(M.header(at(0), ""), 3.0))]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.sources[0].channel == "/drone/bottom/image_raw"
    assert flight.sonar is None
    reading = next(s.reading for s in flight.sources if s.channel == "/range_front")
    assert reading.startswith("by its name it does not look down")


def test_transforms_that_never_change_are_mounts_too(tmp_path):
    """A publisher of fixed transforms may repeat them on /tf, among those of the moving vehicle."""
    belly = ("base_link", "belly", (0.1, 0.0, 0.0), (0.0, HALF, -HALF, 0.0))
    messages = [
        ("/tf", at(k), M.transforms(belly, ("odom", "base_link", (float(k), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))))
        for k in range(3)
    ]
    header = M.header(at(0), "belly")
    messages += [
        ("/cam/image_raw", at(0), M.image(header, picture(1), "bgr8")),
        ("/cam/camera_info", at(0), M.info(header, 5.0)),
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.camera.b_T_c[:3, 3].tolist() == [0.1, 0.0, 0.0]
    assert "mounts are also taken from transforms of /tf that never change; check T_BS" in flight.warnings


def test_without_a_body_the_camera_is_assumed_to_look_down_and_carries_the_imu(tmp_path):
    """A camera with an IMU in optical axes, as stereo and depth cameras have: z ahead, x right."""
    ahead = (0.5, -0.5, 0.5, -0.5)
    frames = M.transforms(
        ("camera_link", "color_optical", (0.0, 0.02, 0.0), ahead),
        ("camera_link", "imu_optical", (0.0, 0.0, 0.0), ahead),
    )
    colour, imu = M.header(at(0), "color_optical"), M.header(at(0), "imu_optical")
    messages = [
        ("/tf_static", START_NS, frames),
        ("/color/image_raw", at(0), M.image(colour, picture(1), "bgr8")),
        ("/color/camera_info", at(0), M.info(colour, 5.0)),
        ("/imu", at(0), M.imu(imu, (0.0,) * 3, (0.0, 0.0, -9.8))),  # looking down, z of the optics is down
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.camera.b_T_c == pytest.approx(NADIR_B_T_C, abs=1e-9)
    assert flight.imu.b_T_s[:3, :3] @ flight.imu.accel_m_s2[0] == pytest.approx([0.0, 0.0, 9.8])
    assert any("no frame of the body is known" in line for line in flight.warnings)


def test_headers_on_another_clock_are_moved_onto_that_of_the_recorder(tmp_path):
    since_start_ns = 50 * 10**9
    messages = []
    for k in range(9):
        camera, imu = M.header(since_start_ns + 10_000_000 * k, "cam"), M.header(at(k), "imu")
        messages += [
            ("/imu", at(k), M.imu(imu, (0.0,) * 3, (0.0, 0.0, 9.8))),
            ("/cam/image_raw", at(k) + 2_000_000 + 100_000 * (k % 3), M.image(camera, picture(k), "bgr8")),
            ("/cam/camera_info", at(k), M.info(camera, 5.0)),
        ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.frames.stamps_s - flight.imu.stamps_s == pytest.approx(0.0021, abs=1e-6)
    assert any("cam0: the clock of its headers" in line for line in flight.warnings)


def a_flight_with(stamps_ns, pictures) -> list[tuple]:
    """Messages of a camera and a range sensor, recorded each 10 ms, with chosen stamps and pictures."""
    messages = []
    for k, (stamp_ns, number) in enumerate(zip(stamps_ns, pictures, strict=True)):
        header = M2.header(stamp_ns, "cam")
        messages += [
            ("/cam/image_raw", at(k), M2.image(header, picture(number), "bgr8")),
            ("/cam/camera_info", at(k), M2.info(header, 5.0)),
            ("/range", at(k), M2.range(M2.header(stamp_ns, "sonar"), 1.5 + 0.01 * k)),
        ]
    return messages


def test_where_the_clock_steps_back_no_picture_is_lost_and_all_streams_are_moved_alike(tmp_path):
    """Pictures before and after the step have the same stamps, but show something else."""
    numbers = np.arange(60)
    stamps_ns = [at(int(k)) - 200_000_000 * bool(k >= 40) for k in numbers]
    flight = read(write(tmp_path / "bag", M2, a_flight_with(stamps_ns, numbers)))
    assert [int(flight.frames[k].read()[0, 0, 0]) for k in range(len(flight.frames))] == numbers.tolist()
    assert flight.frames.stamps_s == pytest.approx(0.01 * numbers)
    assert flight.sonar.stamps_s == pytest.approx(0.01 * numbers)
    assert len(set(flight.frames.names)) == 60
    assert not any("repeated" in line for line in flight.warnings)


def test_a_picture_that_was_recorded_twice_is_kept_once(tmp_path):
    numbers = np.r_[0:30, 10:15, 30:40]
    messages = [m for m in a_flight_with([at(int(k)) for k in numbers], numbers) if m[0] != "/range"]
    flight = read(write(tmp_path / "bag", M2, messages))
    assert [int(flight.frames[k].read()[0, 0, 0]) for k in range(len(flight.frames))] == list(range(40))
    assert any("cam0: 5 repeated rows dropped" in line for line in flight.warnings)


def test_a_range_sensor_that_looks_ahead_is_no_height(tmp_path):
    frames = M.transforms(
        ("base_link", "ahead", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        ("base_link", "down", (0.0, 0.0, 0.0), (HALF, 0.0, HALF, 0.0)),
    )
    messages = [("/tf_static", START_NS, frames)]
    messages += [
        (f"/{name}", at(0), M.range(M.header(at(0), name), value))
        for name, value in (("ahead", 3.0), ("down", 2.0))
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.sonar.range_m.tolist() == [2.0]
    reading = next(s.reading for s in flight.sources if s.channel == "/ahead")
    assert reading.startswith("looks 90 degrees away from straight down")


def test_an_orientation_of_a_turned_imu_becomes_the_body_s(tmp_path):
    """The IMU is mounted a quarter turn to the left; it reads yaw 90 when the body looks along x."""
    quarter = (HALF, 0.0, 0.0, HALF)
    messages = [
        ("/tf_static", START_NS, M.transforms(("base_link", "imu", (0.0, 0.0, 0.0), quarter))),
        ("/imu", at(0), M.imu(M.header(at(0), "imu"), (1.0, 0.0, 0.0), (0.0, 0.0, 9.75), quarter)),
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.attitude.roll_pitch_yaw_rad[0] == pytest.approx([0, 0, 0], abs=1e-9)
    assert flight.imu.b_T_s[:3, :3] @ flight.imu.gyro_rad_s[0] == pytest.approx([0, 1, 0], abs=1e-9)


def test_odometry_is_levelled(tmp_path):
    """Nose 30 degrees down and 1 m/s along the body's x: cos 30 over the ground, whatever the yaw."""
    pitch, yaw = math.radians(30) / 2, math.radians(50) / 2
    q = (
        math.cos(yaw) * math.cos(pitch),
        -math.sin(yaw) * math.sin(pitch),
        math.cos(yaw) * math.sin(pitch),
        math.sin(yaw) * math.cos(pitch),
    )  # Rz(yaw) Ry(pitch)
    path = ros1(
        tmp_path / "a.bag", [("/odom", at(0), M.odometry(M.header(at(0), "odom"), q, (1.0, 0.5, 0.0)))]
    )
    flight = read(path)
    assert flight.velocity.v_m_s[0] == pytest.approx([math.cos(math.radians(30)), 0.5])
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx([0, 30, 50])
    assert flight.truth is None, "odometry is an estimate"


def test_a_pose_is_a_truth_only_by_its_name_or_on_request(tmp_path):
    messages = [
        (topic, at(k), M.pose(M.header(at(k), "map"), (1.0 + k, 2.0, 3.0), (HALF, 0.0, 0.0, HALF)))
        for topic in ("/mavros/local_position/pose", "/vicon/drone/pose")
        for k in range(3)
    ]
    flight = read(ros1(tmp_path / "a.bag", sorted(messages, key=lambda m: m[1])))
    assert flight.sources[0].channel == "/vicon/drone/pose"
    assert flight.truth.w_T_b[1, :3, 3].tolist() == [2.0, 2.0, 3.0]
    assert flight.truth.w_T_b[1, :3, 0] == pytest.approx([0, 1, 0], abs=1e-9)
    only = ros1(tmp_path / "b.bag", [m for m in messages if "mavros" in m[0]])
    with pytest.raises(InputError, match="without a stream of a flight"):
        read(only)
    assert len(read(only, state_groundtruth_estimate0="/mavros/local_position/pose").truth.stamps_s) == 3


def test_positions_without_a_fix_are_dropped(tmp_path):
    messages = [
        ("/fix", at(k), M.fix(M.header(at(k), "gps"), status, 47.5 + k, 8.25, 488.0))
        for k, status in enumerate((0, -1, 2))
    ]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.gps.latitude_deg.tolist() == [47.5, 49.5]
    assert "gps0: 1 of 3 rows dropped: no position" in flight.warnings


def test_stamps_of_zero_give_way_to_the_time_of_recording(tmp_path):
    messages = [("/imu", at(k), M.imu(M.header(0, "imu"), (0.0,) * 3, (0.0, 0.0, 9.8))) for k in range(4)]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.epoch_ns == START_NS
    assert any("4 stamps are zero: the time of recording is used" in line for line in flight.warnings)


def test_a_stick_is_taken_on_request(tmp_path):
    path = ros1(tmp_path / "a.bag", [("/cmd_vel", at(0), M.twist((0.5, -0.25, 0.125), -1.0))])
    assert read(path, command0="/cmd_vel").command.stick.tolist() == [[0.5, -0.25, 0.125, -1.0]]


@measured
def test_three_recorded_bags_of_one_flight(tmp_path):
    folders = []
    for k, name in enumerate(
        ("ros1-bag/hybrid12s.bag", "ros2-db3/hybrid12s", "mcap/hybrid12s/hybrid12s.mcap")
    ):
        # The camera is named, so that its pictures are not asked where it looks, which takes a second.
        flight = read(SAMPLES / name, cam0="/camera/image_raw/compressed")
        write_flight(flight, tmp_path / str(k), silent)
        folders.append(bytes_of(tmp_path / str(k)))
    assert folders[0] == folders[1] == folders[2]
    again = read_flight(tmp_path / "0")
    assert np.array_equal(again.frames[77].read(), flight.frames[77].read())
    assert np.array_equal(again.imu.accel_m_s2, flight.imu.accel_m_s2)
    assert np.array_equal(again.frames.stamps_s, flight.frames.stamps_s)


@measured
@pytest.mark.parametrize(
    "name",
    ["ros1-bag/example-lz4.bag", "ros1-bag/example-bz2.bag", "ros2-db3/cdr_test_0.db3", "mcap/wbag_0.mcap"],
)
def test_bags_without_instruments_are_refused_in_one_line(name):
    with pytest.raises(InputError, match="without a stream of a flight"):
        read(SAMPLES / name)
