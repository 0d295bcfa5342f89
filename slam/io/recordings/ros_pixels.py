"""Pixels of ``sensor_msgs/Image``. Source: ``sensor_msgs/image_encodings.hpp`` and ``cv_bridge``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Image
from slam.io.images import UnreadableImageError


@dataclass(frozen=True)
class _Encoding:
    channels: int
    conversion: int | None = None
    """OpenCV's conversion to BGR."""
    bytes_per_sample: int = 1


_ENCODINGS = {
    "mono8": _Encoding(1),
    "8UC1": _Encoding(1),
    "bgr8": _Encoding(3),
    "8UC3": _Encoding(3),
    "rgb8": _Encoding(3, cv2.COLOR_RGB2BGR),
    "bgra8": _Encoding(4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Encoding(4, cv2.COLOR_RGBA2BGR),
    "mono16": _Encoding(1, None, 2),
    # OpenCV names a Bayer pattern by its second row and second column.
    "bayer_rggb8": _Encoding(1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": _Encoding(1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": _Encoding(1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": _Encoding(1, cv2.COLOR_BayerGB2BGR),
    "yuv422": _Encoding(2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Encoding(2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Encoding(2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": _Encoding(2, cv2.COLOR_YUV2BGR_YUY2),
}


def is_known(encoding: str) -> bool:
    """Return whether pixels of this encoding can be converted."""
    return encoding in _ENCODINGS


def pixels(message: Any) -> Image:
    """Return the pixels of a message as (h, w, 3) BGR or (h, w) grey, 8 bit.

    Of 16 bits the upper 8 are returned. Raises ``UnreadableImageError`` for an unknown encoding or too few
    bytes.
    """
    known = _ENCODINGS.get(message.encoding)
    if known is None:
        raise UnreadableImageError(f"has the encoding {message.encoding[:20]!r}")
    width, height, step = int(message.width), int(message.height), int(message.step)
    row_bytes = width * known.channels * known.bytes_per_sample
    data = np.asarray(message.data, np.uint8)
    if not width or not height or step < row_bytes or len(data) < step * height:
        raise UnreadableImageError("damaged")
    rows = data[: step * height].reshape(height, step)[:, :row_bytes]
    if known.bytes_per_sample == 2:
        return np.ascontiguousarray(rows[:, (0 if message.is_bigendian else 1) :: 2])
    grid = np.ascontiguousarray(
        rows.reshape((height, width, known.channels) if known.channels > 1 else (height, width))
    )
    return grid if known.conversion is None else _converted(grid, known.conversion)


def _converted(grid: NDArray[np.uint8], conversion: int) -> Image:
    return np.asarray(cv2.cvtColor(grid, conversion), dtype=np.uint8)
