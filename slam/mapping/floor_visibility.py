"""Attitude readings by which the camera looks at the sky, while its pictures match as only a floor does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backend.wording import either
from frontend.camera import Camera
from slam.core.flight import Flight

LEAST_FALL = 0.17
"""Smallest downward component of a unit vector that still meets the floor. Within 10 degrees of the horizon
neither a picture nor an echo gives information about it."""


def without_horizon_frames(flight: Flight, camera: Camera) -> Flight:
    """The flight without the attitudes by which the camera does not look at the floor; they are counted.

    A tumbling vehicle's pictures match no floor, so that a flight loses nothing with them. What is left out
    is an instrument that is broken, upside down, or of another convention.
    """
    if flight.attitude is None:
        return flight
    angles = flight.attitude.roll_pitch_yaw_rad
    roll, pitch, _ = angles.T
    up = np.column_stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    away = up @ camera.b_T_c[:3, 2] > -LEAST_FALL  # not where an angle is missing
    if not away.any():
        return flight
    warning = (
        f"attitude0: according to {away.sum()} of {len(away)} readings the camera looks at the horizon or "
        f"the sky; {either(away.sum(), 'it is', 'they are')} left out; check its angles, and T_BS in "
        f"{flight.camera_file}"
    )
    left = np.where(away[:, None], np.nan, angles)
    attitude = None if away.all() else replace(flight.attitude, roll_pitch_yaw_rad=left)
    return replace(flight, attitude=attitude).with_warning(warning)
