"""Heading at the start, where positions are known but no yaw.

Positions tell how the vehicle accelerates over ground, and the accelerometer how it leans, in body axes. The
two agree at one heading. The filter finds it from a start nearby; the start is the most likely of many.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.errors import BackendError
from backend.significance import STRONG_NATS
from slam.core.rotations import roll_pitch_yaw_of
from slam.inertial.filter_input import START_YAW_STD_RAD, Adjustments, StartHeading, filter_input
from slam.inertial.instruments import InertialTrust
from slam.inertial.start_height import START_ROUNDS, likelihood_of
from slam.inertial.zero_velocity import RestWindows

if TYPE_CHECKING:
    from backend.ekf.results import Track
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_HEADINGS_RAD = np.arange(12) * np.pi / 6
"""Headings that are tried, so close that the best one is off by half of `START_YAW_STD_RAD` at most."""
_UNKNOWN_STD_RAD = np.pi / np.sqrt(3)
"""Standard deviation of an angle that may be any."""


def find_start_heading(flight: Flight, trust: InertialTrust, lasts_s: float) -> StartHeading | None:
    """Return the heading at the start by the first ``lasts_s`` seconds of motion.

    It is unknown where another heading is about as likely. The result is None where a yaw is measured or the
    world has no other north than the first heading. Raises ``InputError`` where too little was recorded.
    """
    readings = filter_input(flight, trust).readings
    own = readings.roll_pitch_yaw_rad
    if readings.w_p_antenna_m is None or (own is not None and np.isfinite(own.values[:, 2]).any()):
        return None
    scores, ends_rad = np.full(len(_HEADINGS_RAD), -np.inf), np.zeros(len(_HEADINGS_RAD))
    for k, heading_rad in enumerate(_HEADINGS_RAD.tolist()):
        try:
            start = StartHeading(heading_rad, START_YAW_STD_RAD)
            found = _tracked(flight, trust, start, lasts_s, rounds=0)
        except BackendError:
            continue
        scores[k], ends_rad[k] = likelihood_of(found), _yaw_rad(found.filtered.w_T_b[-1])
    best = int(np.argmax(scores))
    off_rad = np.abs(np.angle(np.exp(1j * (ends_rad - ends_rad[best]))))
    rivals = scores[off_rad > 1.5 * _HEADINGS_RAD[1]]
    if not scores[best] > rivals.max(initial=-np.inf) + STRONG_NATS:
        return StartHeading(0.0, _UNKNOWN_STD_RAD, is_known=False)
    start = StartHeading(float(_HEADINGS_RAD[best]), START_YAW_STD_RAD)
    smoothed = _tracked(flight, trust, start, lasts_s, START_ROUNDS).smoothed
    assert smoothed is not None
    return StartHeading(_yaw_rad(smoothed.w_T_b[0]), START_YAW_STD_RAD)


def _tracked(
    flight: Flight, trust: InertialTrust, heading: StartHeading, lasts_s: float, rounds: int
) -> Track:
    """Return the motion at the start and after ``lasts_s`` seconds of motion. Raises ``BackendError``."""
    from backend.ekf.track import track

    inputs = filter_input(flight, trust, Adjustments(heading=heading))
    until_s = min(inputs.end_s, RestWindows.of(flight).first_motion_s(inputs.start_s) + lasts_s)
    readings = inputs.readings.between(inputs.start_s, until_s)
    return track(readings, np.array([inputs.start_s, until_s]), inputs.start, inputs.model, rounds=rounds)


def _yaw_rad(w_T_b: Array) -> float:
    return float(roll_pitch_yaw_of(w_T_b[:3, :3])[2])
