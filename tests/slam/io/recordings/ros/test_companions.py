"""Topics of ROS bags that are no measurement, are not in the body's axes, or hold half of a reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import HALF, ROS1, Maker, at, ros1

M = Maker(ROS1)
COUNT = 5
NORTH = (HALF, 0.0, 0.0, HALF)
"""Attitude of a level body whose nose points north, along the world's y."""


def series(topic: str, frame: str, make, count: int = COUNT) -> list:
    """Messages of one topic, 10 ms apart."""
    return [(topic, at(k), make(M.header(at(k), frame), k)) for k in range(count)]


def velocities(topic: str, frame: str, linear: tuple) -> list:
    kind = "geometry_msgs/msg/TwistStamped"
    return series(topic, frame, lambda header, k: M.make(kind, header=header, twist=M.twist(linear)))


def attitudes(q: tuple = NORTH) -> list:
    kind = "geometry_msgs/msg/QuaternionStamped"
    make = lambda header, k: M.make(kind, header=header, quaternion=M.quaternion(*q))  # noqa: E731
    return series("/attitude", "base_link", make)


def imus(topic: str, frame: str, gyro: tuple, accel: tuple, q: tuple | None = None) -> list:
    """An accelerometer's x counts the messages, unless it is 0 as a whole."""
    return series(
        topic,
        frame,
        lambda header, k: M.imu(header, gyro, (k * any(accel) + accel[0], *accel[1:]), q),
    )


def reason(flight, channel: str) -> str:
    return next(s.reading for s in flight.sources if s.channel == channel and not s.stream)


def test_a_velocity_in_the_body_is_preferred_to_one_in_the_world(tmp_path):
    world = velocities("/mavros/local_position/velocity_local", "map", (0.0, 2.0, 0.0))
    body = velocities("/mavros/local_position/velocity_body", "base_link", (2.0, 0.5, 0.0))
    flight = read(ros1(tmp_path / "a.bag", [*world, *body, *attitudes()]))
    assert flight.velocity.v_m_s[0].tolist() == [2.0, 0.5]


@pytest.mark.parametrize(("frame", "linear"), [("map", (-0.5, 2.0, 0.0)), ("map_ned", (2.0, -0.5, 0.0))])
def test_a_velocity_in_the_world_is_turned_by_the_attitude(tmp_path, frame, linear):
    world = velocities("/velocity", f"uav1/{frame}", linear)
    flight = read(ros1(tmp_path / "a.bag", [*world, *attitudes()]))
    assert flight.velocity.v_m_s[1] == pytest.approx([2.0, 0.5]), "the nose points north"
    taken = next(s for s in flight.sources if s.stream == "velocity0")
    assert f"from the world's axes (uav1/{frame}) by the yaw of attitude0" in taken.reading


def test_a_yaw_that_passes_180_degrees_is_interpolated_the_short_way(tmp_path):
    """The vehicle heads west, and flies west between the readings of its attitude."""
    kind = "geometry_msgs/msg/QuaternionStamped"
    half = np.radians((178, 182, 178, 182)) / 2
    turns = [
        ("/attitude", at(k), M.make(kind, header=M.header(at(k), "base_link"), quaternion=quaternion))
        for k, quaternion in enumerate(M.quaternion(np.cos(a), 0.0, 0.0, np.sin(a)) for a in half)
    ]
    make = lambda k: M.make(  # noqa: E731
        "geometry_msgs/msg/TwistStamped",
        header=M.header(at(k) + 5_000_000, "map"),
        twist=M.twist((-5.0, 0.0, 0.0)),
    )
    world = [("/velocity", at(k) + 5_000_000, make(k)) for k in range(3)]
    flight = read(ros1(tmp_path / "a.bag", [*world, *turns]))
    assert flight.velocity.v_m_s == pytest.approx(np.tile([5.0, 0.0], (3, 1)), abs=1e-9)


def test_a_velocity_is_turned_by_the_attitude_that_is_taken(tmp_path):
    """The IMU states a quaternion of zeros, and leaves its place to the odometry."""
    imu = imus("/imu", "base_link", (0.1, 0, 0), (0, 0, 9.8), (0.0, 0.0, 0.0, 0.0))
    make = lambda header, k: replace(M.odometry(header, NORTH, (1.0, 0, 0)), child_frame_id="")  # noqa: E731
    world = velocities("/velocity", "map", (-0.5, 2.0, 0.0))
    odometry = series("/odom", "map", make)
    east = [("/east", *message) for _, *message in attitudes((1.0, 0.0, 0.0, 0.0))]
    flight = read(ros1(tmp_path / "a.bag", [*imu, *odometry, *world]))
    assert next(s.channel for s in flight.sources if s.stream == "attitude0") == "/odom"
    assert next(s.channel for s in flight.sources if s.stream == "velocity0") == "/velocity"
    assert flight.velocity.v_m_s[1] == pytest.approx([2.0, 0.5])
    both = ros1(tmp_path / "b.bag", [*odometry, *world, *east])
    flight = read(both, attitude0="/east", velocity0="/velocity")
    assert flight.velocity.v_m_s[1] == pytest.approx([-0.5, 2.0])
    flight = read(both, attitude0="/odom", velocity0="/velocity")
    assert flight.velocity.v_m_s[1] == pytest.approx([2.0, 0.5])
    without = read(both, attitude0="", velocity0="/velocity")
    assert any("turned by the yaw of /east, which is left out" in line for line in without.warnings)


def test_an_imu_comes_before_an_odometry_of_the_same_assumption(tmp_path):
    imu = imus("/imu", "imu_link", (0.1, 0, 0), (0, 0, 9.8), NORTH)
    flight = read(ros1(tmp_path / "a.bag", [*odometries("/vio", "", (1.0, 0.0, 0.0)), *imu]))
    assert next(s.channel for s in flight.sources if s.stream == "attitude0") == "/imu"


def test_a_velocity_in_the_world_without_an_attitude_is_left(tmp_path):
    imu = imus("/imu", "base_link", (0.1, 0, 0), (0, 0, 9.8))
    flight = read(ros1(tmp_path / "a.bag", [*velocities("/velocity", "odom", (1.0, 2.0, 0.0)), *imu]))
    assert flight.velocity is None
    assert "no attitude to turn it by" in reason(flight, "/velocity")
    asked = read(tmp_path / "a.bag", velocity0="/velocity")
    assert asked.velocity.v_m_s[0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("topic", ["/mavros/setpoint_velocity/cmd_vel", "/target/velocity", "/reference"])
def test_a_command_is_no_measurement(tmp_path, topic):
    messages = [*velocities(topic, "base_link", (1.0, 0.0, 0.0)), *attitudes()]
    flight = read(ros1(tmp_path / "a.bag", messages))
    assert flight.velocity is None
    assert "a command, no measurement" in reason(flight, topic)


def odometries(topic: str, child: str, linear: tuple) -> list:
    def make(header, k: int):
        turned = (np.cos(0.01 * k), 0.0, 0.0, np.sin(0.01 * k))
        return replace(M.odometry(header, turned if k else (1.0, 0, 0, 0), linear), child_frame_id=child)

    return series(topic, "world", make)


def test_odometry_without_a_velocity_leaves_its_place_to_the_next(tmp_path):
    empty = odometries("/vins/odometry", "", (0.0, 0.0, 0.0))
    full = odometries("/other/odometry", "base_link", (1.0, 2.0, 0.0))
    flight = read(ros1(tmp_path / "a.bag", [*empty, *full]))
    assert flight.velocity.v_m_s[0] == pytest.approx([1.0, 2.0])
    assert next(s.channel for s in flight.sources if s.stream == "velocity0") == "/other/odometry"
    alone = read(ros1(tmp_path / "b.bag", empty))
    assert alone.velocity is None
    assert any("velocity0: no message has a value" in line for line in alone.warnings)
    assert any("0 throughout" in line for line in alone.warnings)


@pytest.mark.parametrize("topic", ["/imu", "/accel_gyro"])
def test_a_gyro_that_reads_0_at_rest_is_one(tmp_path, topic):
    flight = read(ros1(tmp_path / "a.bag", imus(topic, "base_link", (0.0, 0.0, 0.0), (0.5, 0.0, 9.8))))
    assert flight.imu.gyro_rad_s.tolist() == [[0.0, 0.0, 0.0]] * COUNT


def test_a_stated_lack_of_an_accelerometer_is_not_called_zero(tmp_path):
    unknown = np.array([-1.0, *[0.0] * 8])
    made = imus("/imu", "base_link", (0.1, 0.2, 0.3), (0.5, 0.0, 9.8), NORTH)
    stated = [(*each, replace(m, linear_acceleration_covariance=unknown)) for *each, m in made]
    flight = read(ros1(tmp_path / "a.bag", stated))
    assert flight.imu is None
    assert not any("0 throughout" in line for line in flight.warnings)
    assert any("states throughout that it does not measure" in line for line in flight.warnings)


@pytest.mark.parametrize("moves", [True, False])
def test_a_twist_of_zero_is_none_where_the_position_changes(tmp_path, moves):
    def make(header, k: int):
        message = M.odometry(header, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        pose = replace(message.pose.pose, position=M.vector(0.1 * k * moves, 0.0, 0.0, kind="Point"))
        return replace(message, pose=replace(message.pose, pose=pose))

    flight = read(ros1(tmp_path / "a.bag", series("/odometry", "odom", make)))
    assert (flight.velocity is None) == moves


def test_odometry_with_its_twist_in_the_world_is_turned_by_its_pose(tmp_path):
    def make(header, k: int):
        return replace(M.odometry(header, NORTH, (-0.5, 2.0, 0.0)), child_frame_id="world")

    flight = read(ros1(tmp_path / "a.bag", series("/odometry", "world", make)))
    assert flight.velocity.v_m_s[0] == pytest.approx([2.0, 0.5])


def test_the_two_halves_of_an_imu_are_joined(tmp_path):
    still, gyro = (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)
    accel = imus("/camera/accel/sample", "imu", still, (0.5, 0.0, 9.8))
    turns = imus("/camera/gyro/sample", "imu", gyro, still)
    flight = read(ros1(tmp_path / "a.bag", [*accel, *turns]))
    assert flight.imu.gyro_rad_s[1].tolist() == list(gyro)
    assert flight.imu.accel_m_s2[:, 0] == pytest.approx([0.5, 1.5, 2.5, 3.5, 4.5])
    assert "read with /camera/gyro/sample" in reason(flight, "/camera/accel/sample")
    alone = read(ros1(tmp_path / "b.bag", [*accel, *velocities("/v", "base_link", (1.0, 0.0, 0.0))]))
    assert alone.imu is None, "an IMU without a gyro is none"


def test_an_imu_in_the_axes_of_a_camera_needs_a_transform(tmp_path):
    camera = imus("/camera/imu", "camera_imu_optical_frame", (0.1, 0, 0), (0, 9.8, 0))
    body = imus("/mavros/imu/data", "base_link", (0.2, 0, 0), (0, 0, 9.8))
    flight = read(ros1(tmp_path / "a.bag", [*camera, *body]))
    assert flight.imu.gyro_rad_s[0, 0] == 0.2
    assert "axes of a camera" in reason(flight, "/camera/imu")


def test_an_imu_in_a_frame_of_the_body_is_preferred_and_the_other_is_named(tmp_path):
    other = imus("/a/imu", "a_imu", (0.1, 0, 0), (0, 0, 9.8), NORTH)
    body = imus("/b/imu", "fcu", (0.2, 0, 0), (0, 0, 9.8))
    flight = read(ros1(tmp_path / "a.bag", [*other, *body]))
    assert flight.imu.gyro_rad_s[0, 0] == 0.2
    assert next(s.channel for s in flight.sources if s.stream == "attitude0") == "/a/imu"
    assert reason(flight, "/a/imu") == "/b/imu taken as imu0; take it by --topic imu0=/a/imu"


def test_a_receiver_without_a_fix_leaves_its_place_to_the_next(tmp_path):
    none = series("/a/fix", "gps", lambda header, k: M.fix(header, -1, 0.0, 0.0, 0.0))
    fixed = series("/b/fix", "gps", lambda header, k: M.fix(header, 0, 47.0, 8.0, 500.0))
    flight = read(ros1(tmp_path / "a.bag", [*none, *fixed]))
    assert flight.gps.latitude_deg[0] == 47.0
    assert flight.gps.height_system == "EPSG:4979", "the ellipsoid"
    assert reason(flight, "/a/fix") == "no message has a value; take it by --topic gps0=/a/fix"
    assert flight.gps.noise_assumed, "no covariance is stated"


def test_a_receiver_states_its_accuracy(tmp_path):
    def make(header, k: int):
        fix = M.fix(header, 0, 60.0, 8.0, 500.0)
        variances = np.diag([0.01, 0.04, 0.09]).ravel() * (1 if k else 100)
        return replace(fix, position_covariance=variances, position_covariance_type=2)

    flight = read(ros1(tmp_path / "a.bag", series("/fix", "gps", make)))
    assert flight.gps.noise_std_m == pytest.approx((0.1, 0.2, 0.3), rel=1e-6), "the median, east, north, up"
    assert not flight.gps.noise_assumed


def test_a_range_sensor_with_limits_of_zero_states_none(tmp_path):
    make = lambda header, k: replace(M.range(header, 1.5), min_range=0.0, max_range=0.0)  # noqa: E731
    flight = read(ros1(tmp_path / "a.bag", series("/range", "sonar", make)))
    assert flight.sonar.range_m.tolist() == [1.5] * COUNT
