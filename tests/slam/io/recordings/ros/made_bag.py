"""Small ROS bags with messages whose values are chosen by hand, in the three containers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
PICTURE_PX = (6, 4)
HALF = math.sqrt(0.5)
START_NS = 1_600_000_000_000_000_000


class Maker:
    """Makes messages of one generation of ROS."""

    def __init__(self, store: Any) -> None:
        self.store = store
        self.is_1 = store is ROS1

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        more = {"seq": 0} if self.is_1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, w: float, x: float, y: float, z: float) -> Any:
        return self.make("geometry_msgs/msg/Quaternion", w=w, x=x, y=y, z=z)

    def imu(self, header: Any, gyro: tuple, accel: tuple, q: tuple | None = None) -> Any:
        unknown = np.array([-1.0, *[0.0] * 8])
        return self.make(
            "sensor_msgs/msg/Imu",
            header=header,
            orientation=self.quaternion(*(q or (1.0, 0.0, 0.0, 0.0))),
            orientation_covariance=np.zeros(9) if q else unknown,
            angular_velocity=self.vector(*gyro),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.vector(*accel),
            linear_acceleration_covariance=np.zeros(9),
        )

    def range(self, header: Any, distance: float) -> Any:
        return self.make(
            "sensor_msgs/msg/Range",
            header=header,
            radiation_type=0,
            field_of_view=0.5,
            min_range=0.25,
            max_range=4.0,
            range=distance,
        )

    def pose(self, header: Any, position: tuple, q: tuple) -> Any:
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(*position, kind="Point"),
            orientation=self.quaternion(*q),
        )
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)

    def twist(self, linear: tuple, yaw_rate: float = 0.0) -> Any:
        return self.make(
            "geometry_msgs/msg/Twist", linear=self.vector(*linear), angular=self.vector(0.0, 0.0, yaw_rate)
        )

    def odometry(self, header: Any, q: tuple, linear: tuple) -> Any:
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector(1.0, 2.0, 3.0, kind="Point"),
            orientation=self.quaternion(*q),
        )
        return self.make(
            "nav_msgs/msg/Odometry",
            header=header,
            child_frame_id="base_link",
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=self.twist(linear), covariance=np.zeros(36)
            ),
        )

    def fix(self, header: Any, status: int, latitude: float, longitude: float, altitude: float) -> Any:
        return self.make(
            "sensor_msgs/msg/NavSatFix",
            header=header,
            status=self.make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def image(self, header: Any, pixels: np.ndarray, encoding: str) -> Any:
        return self.make(
            "sensor_msgs/msg/Image",
            header=header,
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=pixels[0].nbytes,
            data=np.ascontiguousarray(pixels).view(np.uint8).ravel(),
        )

    def compressed(self, header: Any, data: bytes, code: str) -> Any:
        return self.make(
            "sensor_msgs/msg/CompressedImage", header=header, format=code, data=np.frombuffer(data, np.uint8)
        )

    def info(self, header: Any, focal: float, model: str = "plumb_bob", d: tuple = (0.0,) * 5) -> Any:
        size = PICTURE_PX
        k = np.array([focal, 0, (size[0] - 1) / 2, 0, focal, (size[1] - 1) / 2, 0, 0, 1.0])
        names = "DKRP" if self.is_1 else "dkrp"
        matrices = dict(zip(names, (np.array(d), k, np.eye(3).ravel(), np.zeros(12)), strict=True))
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=header,
            height=size[1],
            width=size[0],
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=region,
            **matrices,
        )

    def transforms(self, *each: tuple[str, str, tuple, tuple]) -> Any:
        """Fixed transforms: parent, child, translation, quaternion w first."""
        made = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(START_NS, parent),
                child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.vector(*translation),
                    rotation=self.quaternion(*rotation),
                ),
            )
            for parent, child, translation, rotation in each
        ]
        return self.make("tf2_msgs/msg/TFMessage", transforms=made)


def write(
    path: Path,
    maker: Maker,
    messages: list[tuple[str, int, Any]],
    mcap: bool = False,
    chunk_bytes: int | None = None,
) -> Path:
    """Write messages (topic, time of recording, message); return what ``slam`` is given."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Writer1(path) if maker.is_1 else Writer2(path, version=9, storage_plugin=plugin)
    if chunk_bytes is not None:
        writer.chunk_threshold = chunk_bytes
    with writer:
        connections: dict[str, Any] = {}
        for topic, time_ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=maker.store)
            serialize = maker.store.serialize_ros1 if maker.is_1 else maker.store.serialize_cdr
            writer.write(connections[topic], time_ns, serialize(message, kind))
    return path


def ros1(path: Path, messages: list[tuple[str, int, Any]]) -> Path:
    return write(path, Maker(ROS1), messages)


def at(k: int) -> int:
    return START_NS + k * 10_000_000


def picture(k: int) -> np.ndarray:
    """Picture ``k``, 4 x 6 px in colour; each channel has its own value."""
    return np.tile(np.array([k, 100 + k, 200], np.uint8), (4, 6, 1))


def png(k: int) -> bytes:
    return bytes(cv2.imencode(".png", picture(k))[1])


def a_flight(maker: Maker) -> list[tuple]:
    """Messages of a camera, an IMU and a range sensor, recorded 3 ms after their stamps."""
    late = 3_000_000
    down = (("base_link", "sonar", (0.1, 0.0, -0.05), (HALF, 0.0, HALF, 0.0)),)  # the sensor's x points down
    messages = [("/tf_static", START_NS, maker.transforms(*down))]
    for k in range(5):
        header = maker.header(at(k), "cam")
        messages += [
            ("/cam/image_raw/compressed", at(k) + late, maker.compressed(header, png(k), "png")),
            ("/cam/camera_info", at(k) + late, maker.info(header, 5.0)),
            (
                "/imu",
                at(k) + late,
                maker.imu(maker.header(at(k), "base_link"), (0.1, 0.2, 0.3), (0.5, 0.25, 9.75)),
            ),
            (
                "/range",
                at(k) + late,
                maker.range(maker.header(at(k), "sonar"), (1.5, 0.125, math.inf)[k % 3]),
            ),
        ]
    return messages


def without_index(path: Path) -> Path:
    """Cut a ROS 1 bag as its recorder leaves it when it dies: no index, and its place in the header is 0."""
    content = path.read_bytes()
    at = content.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(content[at : at + 8], "little")
    path.write_bytes(content[:at] + bytes(8) + content[at + 8 : index])
    return path
