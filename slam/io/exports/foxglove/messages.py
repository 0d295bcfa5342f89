"""Poses, pictures, places, points and lines as messages of Foxglove's schemas.

Frames have the names and axes of `slam.io.exports.bag_messages`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.io.exports.bag_messages import BODY, CAMERA, WORLD

Array = NDArray[np.float64]
Message = Any
Rgb = tuple[int, int, int]

_POINT_TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgba", "u1", 4)])
_LINE_PX = 2.0


def pose_in_frame(stamp_ns: int, w_T_b: Array) -> Message:
    """Return the pose (4, 4) of the body in the map."""
    return PoseInFrame(timestamp=_time(stamp_ns), frame_id=WORLD, pose=_pose(w_T_b))


def odometry(stamp_ns: int, w_T_b: Array, covariance: Array, metadata: Mapping[str, str]) -> Message:
    """Return the pose with its covariance (6, 6) along the axes of the map, translation first.

    Foxglove writes an unknown covariance as zeros.
    """
    known = covariance if np.isfinite(covariance).all() else np.zeros((6, 6))
    return Odometry(
        timestamp=_time(stamp_ns),
        frame_id=WORLD,
        body_frame_id=BODY,
        pose=_pose(w_T_b),
        pose_covariance=known.ravel().tolist(),
        metadata=_pairs(metadata),
    )


def path(stamp_ns: int, w_T_b: Array) -> Message:
    """Return all poses (n, 4, 4)."""
    return PosesInFrame(timestamp=_time(stamp_ns), frame_id=WORLD, poses=_poses(w_T_b))


def transforms(stamp_ns: int, parent: str, child: str, T: Array) -> Message:
    """Return the pose (4, 4) of the frame ``child`` in ``parent`` for the tree of frames."""
    pose = _pose(T)
    one = FrameTransform(
        timestamp=_time(stamp_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=pose.position,
        rotation=pose.orientation,
    )
    return FrameTransforms(transforms=[one])


def image(stamp_ns: int, jpeg: bytes) -> Message:
    """Return a picture of the camera."""
    return CompressedImage(timestamp=_time(stamp_ns), frame_id=CAMERA, data=jpeg, format="jpeg")


def calibration(stamp_ns: int, camera: Camera) -> Message:
    """Return the camera of a picture."""
    return CameraCalibration(
        timestamp=_time(stamp_ns),
        frame_id=CAMERA,
        width=camera.size_px[0],
        height=camera.size_px[1],
        distortion_model="plumb_bob" if camera.lens == "brown" else "kannala_brandt",
        D=list(camera.all_distortion),
        K=camera.matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist(),
    )


def location(stamp_ns: int, place: Sequence[float], covariance: Array, w_T_b: Array) -> Message:
    """Return latitude and longitude [deg] and altitude [m] with the covariance (3, 3) east, north, up."""
    is_known = bool(np.isfinite(covariance).all())
    latitude, longitude, altitude = map(float, place)
    return LocationFix(
        timestamp=_time(stamp_ns),
        frame_id=BODY,
        latitude=latitude,
        longitude=longitude,
        altitude=altitude,
        position_covariance=(covariance if is_known else np.zeros((3, 3))).ravel().tolist(),
        position_covariance_type=LocationFix.KNOWN if is_known else LocationFix.UNKNOWN,
        heading=float(np.arctan2(w_T_b[0, 0], w_T_b[1, 0])),
    )


def point_cloud(stamp_ns: int, xyz: Array, rgb: NDArray[np.uint8]) -> Message:
    """Return points (n, 3) of the map with their colours (n, 3)."""
    points = np.zeros(len(xyz), _POINT_TYPE)
    for k, axis in enumerate("xyz"):
        points[axis] = xyz[:, k]
    points["rgba"] = np.column_stack([rgb, np.full(len(rgb), 255)])
    fields = [(axis, PackedElementField.FLOAT32, 4 * k) for k, axis in enumerate("xyz")]
    fields += [(name, PackedElementField.UINT8, 12 + k) for k, name in enumerate(("red", "green", "blue"))]
    fields += [("alpha", PackedElementField.UINT8, 15)]
    return PointCloud(
        timestamp=_time(stamp_ns),
        frame_id=WORLD,
        pose=_pose(np.eye(4)),
        point_stride=_POINT_TYPE.itemsize,
        fields=[PackedElementField(name=name, type=kind, offset=offset) for name, kind, offset in fields],
        data=points.tobytes(),
    )


def lines(
    stamp_ns: int, name: str, ends: Array, rgb: Rgb, metadata: Mapping[str, str] | None = None
) -> Message:
    """Return lines between pairs of points (n, 2, 3) as an entity of a scene, with text for a click on it."""
    red, green, blue = (value / 255 for value in rgb)
    drawn = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        pose=_pose(np.eye(4)),
        thickness=_LINE_PX,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in ends.reshape(-1, 3).tolist()],
        color=Color(r=red, g=green, b=blue, a=1.0),
    )
    return SceneEntity(
        timestamp=_time(stamp_ns), frame_id=WORLD, id=name, metadata=_pairs(metadata or {}), lines=[drawn]
    )


def scene(entities: Sequence[Message]) -> Message:
    """Return an update of a scene. An entity replaces an earlier one of its name."""
    return SceneUpdate(entities=entities)


def log(stamp_ns: int, text: str, *, is_warning: bool) -> Message:
    """Return a line of text."""
    level = Log.WARNING if is_warning else Log.INFO
    return Log(timestamp=_time(stamp_ns), level=level, message=text, name="slam")


def _time(stamp_ns: int) -> Timestamp:
    return Timestamp(seconds=stamp_ns // 10**9, nanos=stamp_ns % 10**9)


def _pose(T: Array) -> Pose:
    return _poses(T[None])[0]


def _poses(T: Array) -> list[Pose]:
    """Return poses (n, 4, 4); many at once cost a tenth of one by one."""
    turns = Rotation.from_matrix(T[:, :3, :3]).as_quat().tolist()
    return [
        Pose(
            position=Vector3(x=at[0], y=at[1], z=at[2]),
            orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]),
        )
        for at, q in zip(T[:, :3, 3].tolist(), turns, strict=True)
    ]


def _pairs(metadata: Mapping[str, str]) -> list[KeyValuePair]:
    return [KeyValuePair(key=key, value=value) for key, value in metadata.items()]
