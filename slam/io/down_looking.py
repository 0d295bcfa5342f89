"""The direction of a camera or range sensor, compared with straight down."""

from __future__ import annotations

import re
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, warning

Array = NDArray[np.float64]

MAX_TILT_DEG = 30.0
"""Largest angle between straight down and the axis of a sensor that looks at the floor."""
LEAST_FALL = 0.17
"""Smallest downward component of a unit vector that still meets the floor. Within 10 degrees of the horizon
neither a picture nor an echo gives information about it."""
_DOWN_WORDS = {"down", "downward", "bottom", "belly", "nadir", "below"}
_ASIDE_WORDS = {"front", "forward", "ahead", "left", "right", "rear", "back", "up", "upward", "side", "top"}


NOSE_AT_TOP = warning(
    "no fixed transform to the body: looking straight down with the nose at the top assumed",
    "record /tf_static if it is mounted otherwise",
)
"""Warning about a camera whose mount nothing tells."""


class Look(IntEnum):
    """Direction in which a sensor looks; the smaller ones are preferred for a map."""

    DOWN = 0
    UNKNOWN = 1
    ASIDE = 2

    @staticmethod
    def of(*names: str) -> Look:
        """Return the direction that the words in a topic and a frame state."""
        words = {word for name in names for word in re.split(r"[^a-z]+", name.lower())}
        if words & _DOWN_WORDS:
            return Look.DOWN
        return Look.ASIDE if words & _ASIDE_WORDS else Look.UNKNOWN


_UP = np.array([0.0, 0.0, 1.0])


def axis_tilt_deg(b_axis: Array, b_up: Array = _UP) -> float:
    """Return the angle between an axis in body axes (3,) and straight down."""
    lengths = np.linalg.norm(b_axis) * np.linalg.norm(b_up)
    return float(np.degrees(np.arccos(np.clip(-b_axis @ b_up / lengths, -1, 1))))


def tilt_remark(tilt_deg: float) -> Message:
    """Return the remark about a camera whose tilt exceeds ``MAX_TILT_DEG``."""
    return warning(
        f"looks {tilt_deg:.0f} degrees away from straight down",
        "a map of the floor cannot fit it: turn the camera, or correct its mount",
    )
