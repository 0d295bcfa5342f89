"""The camera of a ROS recording: its lens from ``CameraInfo``, and its pictures on request."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.messages import Message, clauses_of, unread
from slam.io.down_looking import MAX_TILT_DEG, NOSE_AT_TOP, axis_tilt_deg, tilt_remark
from slam.io.files import brief
from slam.io.levels import Raw
from slam.io.picture_headers import UnreadableImageError, encoded_size, suffix_of
from slam.io.recordings.ros import pixels as ros_pixels
from slam.io.recordings.ros.lens import UnknownLensError, lens_of

Array = NDArray[np.float64]
RosMessage = Any


_DEPTH_WORDS = ("depth", "disparity")
_CODED_KINDS = (
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
    "theora_image_transport/msg/Packet",
    "foxglove_msgs/msg/CompressedVideo",
    "foxglove.CompressedVideo",
)
_VIDEO_WORDS = ("h264", "h265", "hevc", "avc", "vp9", "av1")
_CODED = "coded video ({}), which is not decoded: republish it as compressed pictures (image_transport)"


def info_topics(image_topic: str) -> tuple[str, ...]:
    """Return the topics that may hold the ``CameraInfo`` of a topic of pictures."""
    parts = image_topic.split("/")
    return tuple("/".join([*parts[:k], "camera_info"]) for k in range(len(parts) - 1, 0, -1))


def device_of(image_topic: str) -> str:
    """Return the name that the topics of one camera have in common (``image_transport``, ``image_proc``)."""
    folder, _, name = image_topic.removesuffix("/compressed").rpartition("/")
    return folder if name.startswith("image") else f"{folder}/{name}"


def is_rectified(image_topic: str) -> bool:
    """Return whether a topic has pictures without distortion by its name (``image_proc``)."""
    return any(part.startswith("image_rect") for part in image_topic.split("/"))


def info_of(infos: Sequence[tuple[str, RosMessage]], image_topic: str, frame: str) -> RosMessage | None:
    """Return the calibration of a topic of pictures: the one named after it, else of its frame, else the only
    one. ``infos``: topics with a ``CameraInfo``, and their first messages."""
    by_topic = dict(infos)
    named = next((by_topic[name] for name in info_topics(image_topic) if name in by_topic), None)
    same_frame = (m for _, m in infos if frame and m.header.frame_id == frame)
    only = infos[0][1] if len(infos) == 1 else None
    return next(same_frame, only) if named is None else named


def camera_of(
    info: RosMessage | None, first: RosMessage, b_T_c: Array | None, rectified: bool = False
) -> tuple[Camera | None, list[Message]]:
    """Return the camera of a ``CameraInfo``, and the assumptions; None with the reason where unusable.

    ``first`` is the first message with a picture, whose size holds for all. ``rectified``: whether pictures
    have no distortion any more.
    """
    if info is None:
        why = "no CameraInfo beside the pictures, so the lens is unknown"
        return None, [unread(why, "treated as not recorded", "record camera_info with them")]
    size_px = _size_of(first) or (int(info.width), int(info.height))
    try:
        lens, notes = lens_of(info, size_px, rectified)
    except UnknownLensError as reason:
        return None, [unread(*clauses_of(str(reason)), "treated as not recorded")]
    if b_T_c is None:
        notes.append(NOSE_AT_TOP)
    elif (tilt := axis_tilt_deg(b_T_c[:3, 2])) > MAX_TILT_DEG:
        notes.append(tilt_remark(tilt))
    camera = Camera(
        focal_px=lens.focal_px,
        center_px=lens.center_px,
        size_px=size_px,
        distortion=lens.distortion,
        b_T_c=NADIR_B_T_C.copy() if b_T_c is None else b_T_c,
        lens=lens.model,
    )
    return camera, notes


def _size_of(message: RosMessage) -> tuple[int, int] | None:
    """Return (width, height) of the picture in a message; None where it is damaged."""
    if hasattr(message, "encoding"):
        return int(message.width), int(message.height)
    try:
        return encoded_size(bytes(message.data))
    except UnreadableImageError:
        return None


def picture_of(message: RosMessage) -> Raw | bytes:
    """Return the pixels of an ``Image``, or the PNG or JPEG of a ``CompressedImage``.

    Raises ``UnreadableImageError``.
    """
    if hasattr(message, "encoding"):
        return ros_pixels.pixels(message)
    data = bytes(message.data)
    if not data:
        raise UnreadableImageError("empty")
    return data


def tells_samples_only(message: RosMessage) -> bool:
    """Return whether the encoding of a picture tells its samples only, not what they measure: heat, or depths
    as well."""
    return getattr(message, "encoding", "") == "16UC1"


def why_unread(kind: str, message: RosMessage | None) -> str:
    """Return why pictures of a topic cannot be read, and the next step; empty for what is no picture."""
    if kind in _CODED_KINDS:
        return _CODED.format(kind.partition("/")[0].removesuffix("_image_transport_msgs"))
    if message is not None and hasattr(message, "encoding") and not ros_pixels.is_known(message.encoding):
        encoding = brief(message.encoding, 20)
        return f"its encoding {encoding!r} is not read: publish bgr8, rgb8 or mono8 (image_proc, cv_bridge)"
    if message is None or not hasattr(message, "format"):
        return ""
    code = message.format.lower()
    return _CODED.format(message.format[:20]) if any(word in code for word in _VIDEO_WORDS) else ""


def suffix_of_message(message: RosMessage) -> str:
    """Return the suffix of the file that a picture becomes."""
    return ".png" if hasattr(message, "encoding") else suffix_of(bytes(message.data))


def is_picture(message: RosMessage, topic: str) -> bool:
    """Return whether a message holds a picture for the eye, not depths or another code.

    A compressed one is known by its format or, as some drivers leave that empty, by its first bytes. Pixels
    of 16 bits without a meaning are heat, or depths by the name of their topic.
    """
    if hasattr(message, "encoding"):
        is_depth = tells_samples_only(message) and any(word in topic.lower() for word in _DEPTH_WORDS)
        return ros_pixels.is_known(message.encoding) and not is_depth
    code = message.format.lower()
    is_named = any(word in code for word in ("jpeg", "jpg", "png"))
    return "depth" not in code and (is_named or _size_of(message) is not None)
