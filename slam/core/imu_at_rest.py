"""Readings of an IMU at rest: what accelerometer and gyro show there is their own error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.measurements import GRAVITY_M_S2
from slam.core.messages import Message, about
from slam.core.stream_anomalies import (
    LEAST_GRAVITY_M_S2,
    clipping_anomalies,
    imu_axis_anomalies,
    mean_specific_force_m_s2,
)
from slam.core.streams import Imu

Array = NDArray[np.float64]

REST_WINDOW_S, REST_GYRO_STD, REST_ACCEL_STD = 1.0, 0.02, 0.2
"""The vehicle rests if the deviations of gyro (rad/s) and accelerometer (m/s^2) in a window are smaller."""
ACCEL_OFF_M_S2, GYRO_OFF_RAD_S = 0.3, 0.05
"""Largest deviation of a sensor at rest from gravity and from zero that is no anomaly."""
NO_GRAVITY = (
    "gravity was taken out of the readings (linear acceleration), or the vehicle fell freely",
    "record the specific force, as the sensor gives it",
)
"""Cause of readings that hold next to no gravity, and what to do."""


@dataclass(frozen=True)
class GravityReading:
    """A reading of gravity that is off by more than a good accelerometer's."""

    accel_m_s2: float
    b_up: Array
    """(3,) unit vector of the reading in body axes."""
    at_rest: bool
    """Whether it was read at rest; else it is that of the whole flight."""
    is_missing: bool = False
    """Whether the readings of the whole flight hold next to no gravity."""

    @property
    def off_m_s2(self) -> float:
        """Return the reading less gravity."""
        return self.accel_m_s2 - GRAVITY_M_S2

    @property
    def reads(self) -> Message:
        """Return the reading in words."""
        return about("imu0", self._reads)

    @property
    def _reads(self) -> str:
        where = "at rest" if self.at_rest else "on average"
        return f"the accelerometer reads {self.accel_m_s2:.2f} m/s^2 {where}, gravity is 9.81"

    @property
    def warning(self) -> Message:
        """Return the line about it for a flight of which there is no map yet."""
        wrong = "an offset, or a wrong scale, of which lengths are wrong too", "calibrate it"
        cause, do = NO_GRAVITY if self.is_missing else wrong
        return about("imu0", f"{self._reads}: {cause}", do)


def imu_anomalies(imu: Imu) -> list[Message]:
    """Return lines about readings at rest, or of the whole flight where it never rests."""
    gravity, rows = gravity_reading(imu), _rows_at_rest(imu)
    lines = [] if gravity is None else [gravity.warning]
    lines += imu_axis_anomalies(imu) + clipping_anomalies(imu)
    gyro = float(np.linalg.norm(np.median(imu.gyro_rad_s[rows], axis=0))) if len(rows) else 0.0
    if gyro > GYRO_OFF_RAD_S:
        lines.append(
            about(
                "imu0",
                f"the gyro reads {gyro:.3f} rad/s at rest",
                "the map estimates this offset, and other programs need it subtracted",
            ).as_note()
        )
    return lines


def gravity_reading(imu: Imu) -> GravityReading | None:
    """Return a reading of gravity that is off; None where it is right."""
    at_rest = _rows_at_rest(imu)
    rows = at_rest if len(at_rest) else np.flatnonzero(np.isfinite(imu.accel_m_s2).all(axis=1))
    if len(rows) == 0:
        return None
    mean = mean_specific_force_m_s2(imu.stamps_s, imu.accel_m_s2)
    is_missing = mean < LEAST_GRAVITY_M_S2
    # Without gravity, the size of a single reading is that of vibration.
    accel = mean if is_missing else float(np.median(np.linalg.norm(imu.accel_m_s2[rows], axis=1)))
    if not abs(accel - GRAVITY_M_S2) > ACCEL_OFF_M_S2:
        return None
    b_force = imu.b_T_s[:3, :3] @ np.median(imu.accel_m_s2[rows], axis=0)
    b_up = b_force / max(float(np.linalg.norm(b_force)), 1e-9)
    return GravityReading(accel, b_up, len(at_rest) > 0 and not is_missing, is_missing)


def _rows_at_rest(imu: Imu) -> NDArray[np.int64]:
    """Return the numbers of the readings at rest."""
    window = np.floor(imu.stamps_s / REST_WINDOW_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(window, prepend=window[:1] - 1))
    found = [
        rows
        for rows in np.split(np.arange(len(window)), starts[1:])
        if len(rows) >= 10
        and imu.gyro_rad_s[rows].std(axis=0).max() < REST_GYRO_STD
        and imu.accel_m_s2[rows].std(axis=0).max() < REST_ACCEL_STD
    ]
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
