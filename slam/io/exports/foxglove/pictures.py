"""Pictures of keyframes as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from frontend.camera import Camera
from slam.core.streams import Image

WIDTH_PX = 1280
"""Largest width: a panel beside the 3D view is no wider, on a screen of 2560 pixels."""
_QUALITY = 80
"""Quality at which a textured floor takes about a quarter of a byte a pixel, and blocks are not seen."""


def jpeg(picture: Image, camera: Camera) -> bytes:
    """Return a picture, reduced to the size of ``camera`` if it is larger."""
    size = camera.size_px
    if picture.shape[1::-1] != size:
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
