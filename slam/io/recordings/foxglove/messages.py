"""Messages of Foxglove's schemas, and the ROS messages of the same meaning.

The fields come from JSON or protobuf as dictionaries with the same names. Source: Foxglove's documentation,
"Message schemas".
"""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from slam.io.recordings.foxglove.protobuf import ProtobufTypes
from slam.io.recordings.mcap_file import Schema

Values = dict[str, Any]
Message = Any


def decoder(schema: Schema | None, encoding: str) -> Callable[[bytes], Values] | None:
    """Return the function that decodes the messages of a channel; None for an unknown encoding.

    The function raises ``ValueError`` for a damaged message, and this one for a damaged schema.
    """
    if encoding == "json":
        return _json
    if encoding == "protobuf" and schema is not None and schema.encoding == "protobuf":
        types, name = ProtobufTypes(schema.data), schema.name
        return lambda data: types.decode(name, data)
    return None


def _json(data: bytes) -> Values:
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError("a message is not JSON") from error
    if not isinstance(found, dict):
        raise ValueError("a message is no JSON object")
    return found


def _header(values: Values, frame: str | None = None) -> Message:
    stamp = values.get("timestamp") or {}
    seconds = int(stamp.get("sec", stamp.get("seconds", 0)))
    nanoseconds = int(stamp.get("nsec", stamp.get("nanos", 0)))
    name = str(values.get("frame_id", "")) if frame is None else frame
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=name)


def _vector(values: Values | None) -> Message:
    values = values or {}
    return SimpleNamespace(**{axis: float(values.get(axis, 0.0)) for axis in "xyz"})


def _quaternion(values: Values | None) -> Message:
    values = values or {}
    return SimpleNamespace(**{axis: float(values.get(axis, 0.0)) for axis in "xyzw"})


def _data(values: Values) -> Any:
    data = values.get("data", b"")
    if isinstance(data, str):
        try:
            data = base64.b64decode(data, validate=True)
        except binascii.Error:
            raise ValueError("the data of a picture is not base 64") from None
    return np.frombuffer(data, np.uint8)


def _compressed(values: Values) -> Message:
    return SimpleNamespace(header=_header(values), format=str(values["format"]), data=_data(values))


def _raw(values: Values) -> Message:
    sizes = {name: int(values[name]) for name in ("width", "height", "step")}
    encoding = str(values["encoding"])
    return SimpleNamespace(
        header=_header(values), encoding=encoding, is_bigendian=0, data=_data(values), **sizes
    )


def _calibration(values: Values) -> Message:
    return SimpleNamespace(
        header=_header(values),
        width=int(values["width"]),
        height=int(values["height"]),
        distortion_model=str(values.get("distortion_model", "")),
        k=_numbers(values, "K"),
        p=_numbers(values, "P"),
        d=_numbers(values, "D"),
    )


def _numbers(values: Values, name: str) -> list[float]:
    """Return an array; JSON may name it in small letters."""
    return [float(v) for v in values.get(name) or values.get(name.lower()) or ()]


def _fix(values: Values) -> Message:
    place = {name: float(values.get(name, 0.0)) for name in ("latitude", "longitude", "altitude")}
    # Foxglove has no state of the fix; a receiver without one sends zeros.
    status = 0 if place["latitude"] or place["longitude"] else -1
    covariance = [float(v) for v in values.get("position_covariance") or ()]
    return SimpleNamespace(
        header=_header(values),
        status=SimpleNamespace(status=status),
        position_covariance=covariance,
        position_covariance_type=int(len(covariance) == 9 and _is_stated(values)),
        **place,
    )


def _is_stated(values: Values) -> bool:
    """Return whether a fix states its covariance; JSON may name the kind instead of its number."""
    return values.get("position_covariance_type", 0) not in (0, "0", "UNKNOWN")


def _pose(values: Values) -> Message:
    pose = values["pose"]
    # The frame is that in which the pose is given, not one of a sensor on the body.
    return SimpleNamespace(
        header=_header(values, ""),
        pose=SimpleNamespace(
            position=_vector(pose.get("position")), orientation=_quaternion(pose.get("orientation"))
        ),
    )


def _transform(values: Values) -> Message:
    return SimpleNamespace(
        header=_header(values, str(values["parent_frame_id"])),
        child_frame_id=str(values["child_frame_id"]),
        transform=SimpleNamespace(
            translation=_vector(values.get("translation")), rotation=_quaternion(values.get("rotation"))
        ),
    )


def _transforms(values: Values) -> Message:
    return SimpleNamespace(transforms=[_transform(each) for each in values.get("transforms") or ()])


TRANSFORMS = "tf2_msgs/msg/TFMessage"
MEANINGS: dict[str, tuple[str, Callable[[Values], Message]]] = {
    "CompressedImage": ("sensor_msgs/msg/CompressedImage", _compressed),
    "RawImage": ("sensor_msgs/msg/Image", _raw),
    "CameraCalibration": ("sensor_msgs/msg/CameraInfo", _calibration),
    "LocationFix": ("sensor_msgs/msg/NavSatFix", _fix),
    "PoseInFrame": ("geometry_msgs/msg/PoseStamped", _pose),
    "FrameTransform": (TRANSFORMS, lambda values: SimpleNamespace(transforms=[_transform(values)])),
    "FrameTransforms": (TRANSFORMS, _transforms),
}
"""Name of a schema of Foxglove -> the ROS type of the same meaning, and the conversion of its fields."""


def meaning_of(schema: Schema | None) -> tuple[str, Callable[[Values], Message]] | None:
    """Return ROS type and conversion of a schema; None for one that is not Foxglove's, or of no use."""
    if schema is None or not schema.name.startswith("foxglove."):
        return None
    return MEANINGS.get(schema.name.removeprefix("foxglove."))
