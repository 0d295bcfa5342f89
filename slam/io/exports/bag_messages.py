"""The estimate as ROS 2 messages, written by ``rosbags``; no ROS is needed.

| topic | type | what |
|---|---|---|
| /slam/pose | geometry_msgs/PoseWithCovarianceStamped | pose of each keyframe, body in the map |
| /slam/path | nav_msgs/Path | all poses, once |
| /slam/fix | sensor_msgs/NavSatFix | position on Earth of each keyframe, if the map has a place there |
| /tf | tf2_msgs/TFMessage | ``map`` to ``base_link`` at each keyframe |
| /tf_static | tf2_msgs/TFMessage | ``base_link`` to ``camera_optical_frame``, if the map has a camera |

ROS has the axes of a flight: the world is east-north-up (REP 105), the body forward-left-up, and an optical
frame has OpenCV's axes (REP 103).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.io.exports.exported_map import ExportedMap

Array = NDArray[np.float64]
Message = Any

WORLD, BODY, CAMERA = "map", "base_link", "camera_optical_frame"
_BAG_VERSION: Literal[9] = 9
_MAX_SECONDS = 2**31
"""ROS counts seconds in 32 bits with a sign."""
_STATIC = ("/tf_static", "/slam/path")
"""Topics of one message, kept for subscribers that come later."""
_COVARIANCE_KNOWN, _COVARIANCE_UNKNOWN = 3, 0
"""Values of ``NavSatFix.position_covariance_type``."""


def write_bag(exported: ExportedMap, folder: Path) -> None:
    """Write a bag into a new folder.

    Raises ``InputError`` without ``rosbags``, or for a stamp that ROS cannot hold.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            "the package rosbags that writes bags is not installed; run: pip install 'lemniscate-slam[ros]'"
        ) from None
    stamps_ns = exported.keyframes.stamps_ns
    if stamps_ns.min() < 0 or stamps_ns.max() >= _MAX_SECONDS * 10**9:
        raise InputError("a stamp of the map is before 1970 or after 2038, which ROS cannot hold; write tum")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=_BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for topic, stamp_ns, message in _messages(exported, _Maker(store.types)):
            kind = message.__msgtype__
            if topic not in connections:
                quality = [_kept_quality()] if topic in _STATIC else []
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=store, offered_qos_profiles=quality
                )
            writer.write(connections[topic], stamp_ns, store.serialize_cdr(message, kind))


def _messages(exported: ExportedMap, make: _Maker) -> Iterator[tuple[str, int, Message]]:
    """Yield topic, time and message in order of time."""
    frames, camera = exported.keyframes, exported.estimate.camera
    stamps_ns = frames.stamps_ns.tolist()
    if camera is not None:
        mount = make.transform(stamps_ns[0], BODY, CAMERA, camera.b_T_c)
        yield "/tf_static", stamps_ns[0], make.type("tf2_msgs/msg/TFMessage", transforms=[mount])
    yield "/slam/path", stamps_ns[0], make.path(stamps_ns, frames.w_T_b)
    covariances = frames.fixed_axes_covariances
    fixes = _fixes(exported, covariances, make)
    for k, stamp_ns in enumerate(stamps_ns):
        yield "/slam/pose", stamp_ns, make.pose_with_covariance(stamp_ns, frames.w_T_b[k], covariances[k])
        tree = make.transform(stamp_ns, WORLD, BODY, frames.w_T_b[k])
        yield "/tf", stamp_ns, make.type("tf2_msgs/msg/TFMessage", transforms=[tree])
        if fixes:
            yield "/slam/fix", stamp_ns, fixes[k]


def _fixes(exported: ExportedMap, covariances: Array, make: _Maker) -> list[Message]:
    frames = exported.keyframes
    if exported.estimate.origin is None:
        return []
    places = zip(*exported.navigation_fixes(frames), strict=True)
    return [
        make.fix(stamp_ns, place, covariances[k, :3, :3])
        for k, (stamp_ns, place) in enumerate(zip(frames.stamps_ns.tolist(), places, strict=True))
    ]


def _kept_quality() -> Any:
    """Return the quality of service of a topic that keeps its last message."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )


class _Maker:
    """Makes messages from the types of ``rosbags``."""

    def __init__(self, types: dict[str, Any]) -> None:
        self._types = types

    def type(self, kind: str, **fields: Any) -> Message:
        return self._types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Message:
        stamp = self.type("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.type("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose(self, T: Array) -> Message:
        x, y, z = T[:3, 3].tolist()
        position = self.type("geometry_msgs/msg/Point", x=x, y=y, z=z)
        return self.type("geometry_msgs/msg/Pose", position=position, orientation=self._quaternion(T))

    def pose_with_covariance(self, stamp_ns: int, T: Array, covariance: Array) -> Message:
        pose = self.type(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(T), covariance=covariance.ravel()
        )
        return self.type(
            "geometry_msgs/msg/PoseWithCovarianceStamped", header=self.header(stamp_ns, WORLD), pose=pose
        )

    def path(self, stamps_ns: list[int], w_T_b: Array) -> Message:
        poses = [
            self.type("geometry_msgs/msg/PoseStamped", header=self.header(stamp_ns, WORLD), pose=self.pose(T))
            for stamp_ns, T in zip(stamps_ns, w_T_b, strict=True)
        ]
        return self.type("nav_msgs/msg/Path", header=self.header(stamps_ns[0], WORLD), poses=poses)

    def transform(self, stamp_ns: int, parent: str, child: str, T: Array) -> Message:
        x, y, z = T[:3, 3].tolist()
        translation = self.type("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        transform = self.type(
            "geometry_msgs/msg/Transform", translation=translation, rotation=self._quaternion(T)
        )
        return self.type(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=transform,
        )

    def fix(self, stamp_ns: int, place: tuple[float, float, float], covariance: Array) -> Message:
        is_known = bool(np.isfinite(covariance).all())
        latitude, longitude, altitude = map(float, place)
        return self.type(
            "sensor_msgs/msg/NavSatFix",
            header=self.header(stamp_ns, BODY),
            status=self.type("sensor_msgs/msg/NavSatStatus", status=0, service=1),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=covariance.ravel() if is_known else np.zeros(9),
            position_covariance_type=_COVARIANCE_KNOWN if is_known else _COVARIANCE_UNKNOWN,
        )

    def _quaternion(self, T: Array) -> Message:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        return self.type("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
