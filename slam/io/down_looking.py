"""The direction of a camera or range sensor, compared with straight down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_TILT_DEG = 30.0
"""Largest angle between straight down and the axis of a sensor that looks at the floor."""


def axis_tilt_deg(b_axis: Array) -> float:
    """Return the angle between an axis in body axes (3,) and straight down."""
    return float(np.degrees(np.arccos(np.clip(-b_axis[2] / np.linalg.norm(b_axis), -1, 1))))


def tilt_remark(tilt_deg: float) -> str:
    """Return the remark about a camera whose tilt exceeds ``MAX_TILT_DEG``."""
    return (
        f"looks {tilt_deg:.0f} degrees away from straight down; a map of the floor cannot fit it: "
        "turn the camera, or correct its mount"
    )
