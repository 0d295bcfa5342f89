"""The camera of a ROS recording: its lens from ``CameraInfo``, and its pictures on request."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C, Camera
from slam.core.flight import Image
from slam.io.down_looking import MAX_TILT_DEG, axis_tilt_deg, tilt_remark
from slam.io.images import UnreadableImageError
from slam.io.recordings import ros_pixels

Array = NDArray[np.float64]
Message = Any

_RADTAN = ("plumb_bob", "rational_polynomial", "")


def info_topics(image_topic: str) -> tuple[str, ...]:
    """Return the topics that may hold the ``CameraInfo`` of a topic of pictures."""
    parts = image_topic.split("/")
    return tuple("/".join([*parts[:k], "camera_info"]) for k in range(len(parts) - 1, 0, -1))


def camera_of(info: Message | None, b_T_c: Array | None) -> tuple[Camera | None, list[str]]:
    """Return the camera of a ``CameraInfo``, and the assumptions; None with the reason where unusable."""
    if info is None:
        return None, ["no CameraInfo beside the pictures, so the lens is unknown; treated as not recorded"]
    matrix = np.asarray(getattr(info, "k", getattr(info, "K", np.zeros(9))), float).reshape(3, 3)
    coefficients = np.asarray(getattr(info, "d", getattr(info, "D", ())), float)
    model = info.distortion_model
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        return None, ["CameraInfo is not calibrated (its focal length is 0); treated as not recorded"]
    if model not in _RADTAN or np.any(coefficients[5:]):
        return None, [
            f"the lens model {model[:40]!r} with {len(coefficients)} coefficients is not known; "
            "undistort the pictures first (image_proc); treated as not recorded"
        ]
    notes = []
    if b_T_c is None:
        notes.append("no fixed transform to the body: looking straight down with the nose at the top assumed")
    elif (tilt := axis_tilt_deg(b_T_c[:3, 2])) > MAX_TILT_DEG:
        notes.append(tilt_remark(tilt))
    kept = [*coefficients[:5], 0.0, 0.0, 0.0, 0.0][: 5 if len(coefficients) >= 5 else 4]
    camera = Camera(
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        center_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        size_px=(int(info.width), int(info.height)),
        distortion=tuple(float(v) for v in kept),
        b_T_c=NADIR_B_T_C.copy() if b_T_c is None else b_T_c,
    )
    return camera, notes


def picture_of(message: Message) -> Image | bytes:
    """Return the pixels of an ``Image``, or the PNG or JPEG of a ``CompressedImage``.

    Raises ``UnreadableImageError``.
    """
    if hasattr(message, "encoding"):
        return ros_pixels.pixels(message)
    data = bytes(message.data)
    if not data:
        raise UnreadableImageError("empty")
    return data


def suffix_of_message(message: Message) -> str:
    """Return the suffix of the file that a picture becomes."""
    return ".jpg" if not hasattr(message, "encoding") and "png" not in message.format else ".png"


def is_picture(message: Message) -> bool:
    """Return whether a message holds a picture for the eye, not depths or another code."""
    if hasattr(message, "encoding"):
        return ros_pixels.is_known(message.encoding)
    code = message.format.lower()
    return "depth" not in code and any(word in code for word in ("jpeg", "jpg", "png"))
