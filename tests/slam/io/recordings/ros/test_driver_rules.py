"""Messages of drivers under less usual types, rectified and deep pictures, and coded video."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from slam.core.errors import InputError
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.ros.made_bag import Maker, at, picture, ros1, write
from tests.slam.io.recordings.ros.test_companions import M, imus, reason, series

FLOW = (
    "std_msgs/Header header\nuint32 integration_time_us\nfloat32 integrated_x\nfloat32 integrated_y\n"
    "float32 integrated_xgyro\nfloat32 integrated_ygyro\nuint8 quality\nfloat32 distance\n"
)
PX4FLOW = "std_msgs/Header header\nfloat32 ground_distance\nfloat32 velocity_x\nfloat32 velocity_y\n"
PACKET = "std_msgs/Header header\nstring encoding\nuint8[] data\n"
OWN = {
    "mavros_msgs/msg/OpticalFlowRad": FLOW,
    "px_comm/msg/OpticalFlow": PX4FLOW,
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": PACKET,
}
IMU = imus("/imu", "base_link", (0.1, 0, 0), (0, 0, 9.8))


@pytest.fixture
def own() -> Maker:
    """Maker of messages that no version of ROS defines itself."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in OWN.items():
        store.register(get_types_from_msg(text, name))
    return Maker(store)


def written(path, maker: Maker, topic: str, kind: str, **fields):
    message = maker.make(kind, header=maker.header(at(0), "base_link"), **fields)
    return write(path, maker, [(topic, at(0), message)], mcap=True)


def test_flow_of_mavros_in_forward_left_up(tmp_path, own):
    """0.03 rad less 0.01 rad of turn in 0.02 s at 2 m, against y to the left: 2 m/s forward."""
    fields = dict(integration_time_us=20_000, integrated_x=0.01, integrated_y=-0.03, quality=200)
    fields |= dict(integrated_xgyro=0.0, integrated_ygyro=-0.01, distance=2.0)
    flight = read(written(tmp_path / "a", own, "/flow", "mavros_msgs/msg/OpticalFlowRad", **fields))
    assert flight.velocity.v_m_s[0] == pytest.approx([2.0, 1.0], abs=1e-5)
    assert flight.sonar.range_m.tolist() == [2.0]


def test_flow_in_the_axes_of_its_sensor_gives_the_distance_alone(tmp_path, own):
    fields = dict(ground_distance=2.0, velocity_x=1.0, velocity_y=0.5)
    path = written(tmp_path / "a", own, "/px4flow", "px_comm/msg/OpticalFlow", **fields)
    flight = read(path)
    assert (flight.sonar.range_m.tolist(), flight.velocity) == ([2.0], None)
    assert read(path, velocity0="/px4flow").velocity.v_m_s.tolist() == [[1.0, 0.5]]


@pytest.mark.parametrize(("rays", "expected"), [([2.5], [2.5] * 5), ([2.5, 2.5], None)])
def test_a_scan_of_one_ray_is_a_range(tmp_path, rays, expected):
    def make(header, k: int):
        zeros = dict.fromkeys(
            ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time"), 0.0
        )
        ranges = np.array(rays, np.float32)
        limits = dict(range_min=0.2, range_max=40.0)
        kind = "sensor_msgs/msg/LaserScan"
        return M.make(kind, header=header, ranges=ranges, intensities=ranges[:0], **zeros, **limits)

    sonar = read(ros1(tmp_path / "a.bag", [*series("/scan", "laser", make), *IMU])).sonar
    assert (sonar and sonar.range_m.tolist()) == expected
    assert sonar is None or sonar.max_range_m == 40.0


@pytest.mark.parametrize(("pressure", "is_absolute"), [(101_325.0, True), (120.0, False)])
def test_a_pressure_is_a_height_unless_it_is_that_of_an_airspeed(tmp_path, pressure, is_absolute):
    kind = "sensor_msgs/msg/FluidPressure"
    make = lambda header, k: M.make(kind, header=header, fluid_pressure=pressure, variance=0.0)  # noqa: E731
    flight = read(ros1(tmp_path / "a.bag", [*series("/pressure", "base_link", make), *IMU]))
    assert (flight.barometer is not None) == is_absolute
    assert not is_absolute or flight.barometer.value == pytest.approx([0.0] * 5)


@pytest.mark.parametrize("name", ["velocity", "gimbal_angle"])
def test_a_vector_is_a_velocity_by_its_name_alone(tmp_path, name):
    kind = "geometry_msgs/msg/Vector3Stamped"
    make = lambda header, k: M.make(kind, header=header, vector=M.vector(1.0, 2.0, 0.0))  # noqa: E731
    flight = read(ros1(tmp_path / "a.bag", [*series(f"/dji_sdk/{name}", "body", make), *IMU]))
    assert (flight.velocity is not None) == (name == "velocity")


def a_camera(topic: str, info_topic: str, frame: str = "cam", **fields) -> list:
    header = M.header(at(0), frame)
    info = replace(M.info(header, 5.0, d=(-0.3, 0.1, 0.0, 0.0, 0.0)), **fields)
    return [(topic, at(0), M.image(header, picture(1), "bgr8")), (info_topic, at(0), info)]


def test_rectified_pictures_have_the_focal_length_of_p_and_no_distortion(tmp_path):
    projection = np.array([4.0, 0, 2.5, 0, 0, 4.0, 1.5, 0, 0, 0, 1, 0])
    raw = read(ros1(tmp_path / "a.bag", a_camera("/cam/image_raw", "/cam/camera_info", P=projection)))
    assert (raw.camera.focal_px, raw.camera.distortion[0]) == ((5.0, 5.0), -0.3)
    made = a_camera("/cam/image_rect_color", "/cam/camera_info", P=projection)
    flight = read(ros1(tmp_path / "b.bag", made))
    assert (flight.camera.focal_px, flight.camera.is_distorted) == ((4.0, 4.0), False)
    assert any("rectified pictures" in line for line in flight.warnings)
    empty = a_camera("/cam/image_rect_color", "/cam/camera_info")
    assert read(ros1(tmp_path / "c.bag", empty)).camera.focal_px == (5.0, 5.0), "P of zeros states nothing"


def test_the_only_camera_info_is_that_of_the_pictures(tmp_path):
    one = a_camera("/mycam/rgb", "/mycam/info")
    assert read(ros1(tmp_path / "a.bag", one)).camera.focal_px == (5.0, 5.0)
    others = [("/info", at(0), M.info(M.header(at(0), frame), 7.0)) for frame in ("other", "third")]
    two = [(f"{topic}{k}", time, message) for k, (topic, time, message) in enumerate(others)]
    assert read(ros1(tmp_path / "b.bag", [*one, *two])).camera.focal_px == (5.0, 5.0), "of the same frame"
    assert read(ros1(tmp_path / "c.bag", [one[0], *two])).camera is None


@pytest.mark.parametrize(("topic", "is_taken"), [("/thermal/image_raw", True), ("/depth/image_raw", False)])
def test_deep_pixels_without_a_meaning_are_pictures_unless_they_are_depths(tmp_path, topic, is_taken):
    header = M.header(at(0), "cam")
    deep = np.arange(24, dtype=np.uint16).reshape(4, 6) * 100
    messages = [(topic, at(0), M.image(header, deep, "16UC1"))]
    messages += [(f"{topic[:-10]}/camera_info", at(0), M.info(header, 5.0)), *IMU]
    assert (read(ros1(tmp_path / "a.bag", messages)).frames is not None) == is_taken


def test_coded_video_is_named(tmp_path, own):
    header = M.header(at(0), "cam")
    flight = read(
        ros1(tmp_path / "a.bag", [("/cam", at(0), M.compressed(header, b"\0\0\0\1", "h264")), *IMU])
    )
    assert reason(flight, "/cam").startswith("coded video (h264), which is not decoded: republish it")
    kind = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
    alone = written(tmp_path / "b", own, "/cam/ffmpeg", kind, encoding="h264", data=np.zeros(1, np.uint8))
    with pytest.raises(InputError, match=r"/cam/ffmpeg.*coded video"):
        read(alone)
