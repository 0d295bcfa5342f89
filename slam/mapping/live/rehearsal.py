"""Tracking of made pictures before the flight, so that imports and compilation delay no picture of it."""

from __future__ import annotations

import cv2
import numpy as np

from slam.mapping.front_end import FrontEnd

_PICTURES = 4
"""A first keyframe, one picture by features, one by flow, and the next keyframe."""
_STEP_WIDTHS = 0.12
"""Motion from picture to picture: after three, the overlap is small enough for a keyframe."""


def rehearse(front_end: FrontEnd) -> None:
    """Track a few pictures of a made floor, of the size of the camera's."""
    width, height = front_end.camera.size_px
    step_px = max(1, round(_STEP_WIDTHS * width))
    noise = np.random.default_rng(0).normal(size=(height, width + (_PICTURES - 1) * step_px))
    floor = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    begins = range(0, _PICTURES * step_px, step_px)
    pictures = [np.ascontiguousarray(floor[:, x : x + width], dtype=np.uint8) for x in begins]
    for _ in front_end.tracker(look_ahead=False).keyframes(pictures):
        pass
