"""Zero-velocity intervals before take-off, when the speed is better known than from any instrument."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_WINDOW_S, _LEAST_READINGS, _STEP_S = 0.25, 10, 0.05
_GYRO_STD_RAD_S, _ACCEL_STD_M_S2 = 0.01, 0.1
_SPEED_M_S = 0.05


def zero_velocity_times(flight: Flight) -> Array:
    """Return times (n,) at the start of the flight at which the vehicle is at rest; possibly none.

    It is at rest while the spread of gyro and accelerometer is small and no velocity is measured. That is on
    the floor with the motors off, because in the air both spreads are far larger.
    """
    imu = flight.imu
    if imu is None or len(imu.stamps_s) == 0:
        return np.zeros(0)
    begin_s = until_s = float(imu.stamps_s[0])
    while _is_still(imu.stamps_s, imu.gyro_rad_s, imu.accel_m_s2, until_s):
        until_s += _WINDOW_S
    if flight.velocity is not None:
        moving = (np.abs(flight.velocity.v_m_s) > _SPEED_M_S).any(axis=1)
        until_s = min(until_s, float(flight.velocity.stamps_s[moving].min(initial=np.inf)))
    return np.arange(begin_s, until_s, _STEP_S)


def still_times(flight: Flight) -> Array:
    """Return times (n,) of the whole flight at which gyro and accelerometer are as calm as on the floor."""
    imu = flight.imu
    if imu is None or len(imu.stamps_s) == 0:
        return np.zeros(0)
    begins_s = np.arange(imu.stamps_s[0], imu.stamps_s[-1], _WINDOW_S)
    still = [
        _is_still(imu.stamps_s, imu.gyro_rad_s, imu.accel_m_s2, begin_s) for begin_s in begins_s.tolist()
    ]
    return np.asarray(begins_s[still])


def _is_still(stamps_s: Array, gyro_rad_s: Array, accel_m_s2: Array, from_s: float) -> bool:
    first, last = np.searchsorted(stamps_s, [from_s, from_s + _WINDOW_S])
    if last - first < _LEAST_READINGS:
        return False
    gyro, accel = gyro_rad_s[first:last].std(axis=0), accel_m_s2[first:last].std(axis=0)
    return bool((gyro < _GYRO_STD_RAD_S).all() and (accel < _ACCEL_STD_M_S2).all())
