"""A map that leans against the attitude, because heights on Earth tell another slope."""

from __future__ import annotations

import numpy as np

from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.mapping.calibration.attitude_floor_tilt import NOTABLE_RAD, SURE, ZERO_STDS, AttitudeFloorTilt
from slam.mapping.map import Map


def lean_warning(flight: Flight, map_: Map, tilt: AttitudeFloorTilt | None) -> Message | None:
    """Return a warning where the attitude leans against a map that heights on Earth hold; None elsewhere.

    Heights in another unit make slopes of what is level, and take the attitude for noise.
    """
    if tilt is None or not map_.georeferenced or map_.bundle is None or flight.attitude is None:
        return None
    (size, std), stated = tilt.steadier, float(max(flight.attitude.noise_std_rad[:2]))
    if size < max(ZERO_STDS * stated, NOTABLE_RAD) + SURE * std:
        return None
    control = bool(map_.bundle.optimum.problem.measurements.control)
    return warning(
        f"attitude0 leans by {np.degrees(size):.1f}° against the map, which the heights of "
        f"{'control points' if control else 'positions'} hold: heights across the map may be wrong by as "
        "much",
        "check the unit of these heights, and the mounting of the camera (T_BS)",
    ).concerning("attitude0")
