"""Filtered poses of the vehicle at the times of its pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.inertial.motion import filter_motion
from slam.inertial.noise_identification import identify_noise

Array = NDArray[np.float64]


def filter_chain(flight: Flight, stamps_s: Array) -> Array:
    """Return filtered poses (n, 4, 4) at increasing ``stamps_s`` (n,), without the camera.

    This is the paper's map with inertia (IMAV 2011, section 3.1.2: "the resulting position estimate can be
    used as input for the map stitching algorithm"). Poses are NaN outside the interval of recorded motion.
    Raises ``InputError`` where the recording is insufficient.
    """
    inputs = identify_noise(flight)
    inside = (stamps_s >= inputs.start_s) & (stamps_s <= inputs.end_s)
    poses = np.full((len(stamps_s), 4, 4), np.nan)
    poses[inside] = filter_motion(inputs, stamps_s[inside], smooth=False).filtered.w_T_b
    return poses
