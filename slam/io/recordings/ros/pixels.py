"""Pixels of ``sensor_msgs/Image``. Source: ``sensor_msgs/image_encodings.hpp`` and ``cv_bridge``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from slam.io.levels import Raw
from slam.io.picture_headers import UnreadableImageError


@dataclass(frozen=True)
class _Encoding:
    channels: int
    conversion: int | None = None
    """OpenCV's conversion to BGR."""
    bytes_per_sample: int = 1


# OpenCV names a Bayer pattern by its second row and second column.
_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
_ENCODINGS = {
    "mono8": _Encoding(1),
    "8UC1": _Encoding(1),
    "bgr8": _Encoding(3),
    "8UC3": _Encoding(3),
    "rgb8": _Encoding(3, cv2.COLOR_RGB2BGR),
    "bgra8": _Encoding(4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Encoding(4, cv2.COLOR_RGBA2BGR),
    "mono16": _Encoding(1, None, 2),
    "16UC1": _Encoding(1, None, 2),
    "bgr16": _Encoding(3, None, 2),
    "rgb16": _Encoding(3, cv2.COLOR_RGB2BGR, 2),
    **{f"{name}{8 * size}": _Encoding(1, code, size) for name, code in _BAYER.items() for size in (1, 2)},
    "yuv422": _Encoding(2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Encoding(2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Encoding(2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": _Encoding(2, cv2.COLOR_YUV2BGR_YUY2),
}


def is_known(encoding: str) -> bool:
    """Return whether pixels of this encoding can be converted."""
    return encoding in _ENCODINGS


def pixels(message: Any) -> Raw:
    """Return the pixels of a message as (h, w, 3) BGR or (h, w) grey, of 8 or 16 bits.

    Raises ``UnreadableImageError`` for an unknown encoding or too few bytes.
    """
    known = _ENCODINGS.get(message.encoding)
    if known is None:
        raise UnreadableImageError(f"has the encoding {message.encoding[:20]!r}")
    width, height, step = int(message.width), int(message.height), int(message.step)
    row_bytes = width * known.channels * known.bytes_per_sample
    data = np.asarray(message.data, np.uint8)
    if not width or not height or step < row_bytes or len(data) < step * height:
        raise UnreadableImageError("damaged")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row_bytes])
    if known.bytes_per_sample == 2:
        rows = rows.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)
    grid = rows.reshape((height, width, known.channels) if known.channels > 1 else (height, width))
    return grid if known.conversion is None else np.asarray(cv2.cvtColor(grid, known.conversion))
