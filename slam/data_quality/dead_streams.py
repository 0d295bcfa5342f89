"""Dead streams: readings that are missing, never change, or cannot be those of a vehicle in flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight

Array = NDArray[np.float64]

FEWEST_READINGS = 20
"""Least number of readings of a stream."""
MOST_TILT_RAD = 1.2
"""Greatest usual tilt of a vehicle on level rotors. Near a right angle roll and yaw are one."""


def without_dead_streams(flight: Flight) -> tuple[Flight, list[str]]:
    """Return the flight without useless streams, and the reasons. A stream is useless if it is empty, not
    finite or constant, or is an attitude that lies on its side."""
    reasons: list[str] = []
    changes: dict[str, None] = {}
    for name, values in _values(flight).items():
        finite = np.isfinite(values).any(axis=1)
        if finite.sum() < FEWEST_READINGS:
            reasons.append(
                f"{name} has too few readings ({finite.sum()} of at least {FEWEST_READINGS}); it was left out"
            )
            changes[name] = None
        elif all(
            np.ptp(column[np.isfinite(column)]) == 0.0 for column in values.T if np.isfinite(column).any()
        ):
            reasons.append(f"{name} never changes; it was left out")
            changes[name] = None
        elif name == "attitude" and (tilt_rad := _usual_tilt_rad(values)) > MOST_TILT_RAD:
            reasons.append(f"attitude tilts by {np.degrees(tilt_rad):.0f} deg half the time; it was left out")
            changes[name] = None
    return replace(flight, **changes), reasons  # type: ignore[arg-type]


def _usual_tilt_rad(roll_pitch_yaw_rad: Array) -> float:
    known = np.isfinite(roll_pitch_yaw_rad[:, :2]).all(axis=1)
    return float(np.median(np.abs(roll_pitch_yaw_rad[known, :2]).max(axis=1))) if known.any() else 0.0


def _values(flight: Flight) -> dict[str, Array]:
    found: dict[str, Array] = {}
    if flight.imu is not None:
        found["imu"] = np.column_stack([flight.imu.gyro_rad_s, flight.imu.accel_m_s2])
    if flight.attitude is not None:
        found["attitude"] = flight.attitude.roll_pitch_yaw_rad
    if flight.velocity is not None:
        found["velocity"] = flight.velocity.v_m_s
    if flight.sonar is not None:
        found["sonar"] = flight.sonar.range_m[:, None]
    return found
