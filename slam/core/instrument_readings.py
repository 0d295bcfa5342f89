"""Readings of attitude and IMU, in order of time and without what is not finite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backend.measurements import InertialReadings
from slam.core.stream_anomalies import clipped_share
from slam.core.streams import AttitudeSeries, Imu

Array = NDArray[np.float64]

MAX_GAP_S = 0.3
"""A moment farther than this from any sample of a stream has no value of that stream."""


def attitude_readings(series: AttitudeSeries, axes: Sequence[int] = (0, 1, 2)) -> tuple[Array, Array]:
    """Stamps (n,) and angles (n, axes) of an attitude, in order of time; what is not finite is left out."""
    angles = series.roll_pitch_yaw_rad[:, axes]
    good = np.isfinite(angles).all(axis=1)
    stamps_s, first = np.unique(series.stamps_s[good], return_index=True)
    return stamps_s, angles[good][first]


def inertial_readings(imu: Imu | None) -> InertialReadings | None:
    """Gyro and accelerometer turned into body axes, in order of time; what is not finite is left out."""
    if imu is None:
        return None
    good = np.isfinite(imu.gyro_rad_s).all(axis=1) & np.isfinite(imu.accel_m_s2).all(axis=1)
    stamps_s, first = np.unique(imu.stamps_s[good], return_index=True)
    turn = imu.b_T_s[:3, :3].T
    if len(stamps_s) < 2:
        return None
    gyro_rad_s, accel_m_s2 = imu.gyro_rad_s[good][first], imu.accel_m_s2[good][first]
    return InertialReadings(stamps_s, gyro_rad_s @ turn, accel_m_s2 @ turn, clipped_share(accel_m_s2))
