"""A flight's streams as readings for the filter: body axes, with noise that their makers or the record tell.

What is assumed of instruments beyond that stands in ``InertialTrust``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.ekf.inputs import Series
from slam.core.rotations import rotation_of
from slam.inertial.variogram import Wander, noise_and_power, wander
from slam.io.geodesy import enu_from_geodetic

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_UNSEEN_RATE, _UNSEEN_ACCEL = Wander(2.0, 1.0), Wander(3.0, 1.0)
"""How violently a vehicle moves that has no gyro and accelerometer to tell."""


@dataclass(frozen=True)
class InertialTrust:
    """What is assumed of instruments beyond what their makers say; standard deviations."""

    gyro_offset_rad_s: float = 0.02
    gyro_walk_rad_s2: float = 1e-3
    """Per root Hz; no gyro's offset is believed steadier."""
    accel_offset_m_s2: float = 0.3
    accel_walk_m_s3: float = 1e-3
    """Per root Hz; likewise."""
    attitude_floor_rad: float = 0.003
    """White noise: no vehicle's own attitude is believed better than this."""
    tilt_error_rad: float = 0.1
    """Lasting error of its tilt: wind and long accelerations mislead it, an AR.Drone's by 8 degrees."""
    yaw_walk_rad: float = 0.035
    """Per root second: an AR.Drone's own yaw wandered by 17 degrees in 73 s."""
    range_floor_m: float = 0.005
    velocity_floor_m_s: float = 0.02
    velocity_error_m_s: float = 0.06
    """Lasting error on top of the scale: that of an AR.Drone against motion capture."""
    gps_floor_m: float = 0.5
    gps_time_s: float = 5.0
    """For so long the error of one fix is the error of the next."""
    barometer_floor_m: float = 0.1
    barometer_walk_m: float = 0.1
    """Per root second."""
    start_speed_m_s: float = 1.0
    """How fast the vehicle may move at the start where nothing tells."""


def complete(values: Array) -> bool:
    """Whether each column of (n, d) holds more than one figure."""
    return bool((np.isfinite(values).sum(axis=0) > 1).all())


def inertial_of(flight: Flight) -> tuple[Series | None, Series | None, Wander, Wander]:
    """Gyro and accelerometer in body axes, and how body rate and acceleration wander."""
    imu = flight.imu
    if imu is None or len(imu.stamps_s) < 2:
        return None, None, _UNSEEN_RATE, _UNSEEN_ACCEL
    R = imu.b_T_s[:3, :3]
    gyro, accel = imu.gyro_rad_s @ R.T, imu.accel_m_s2 @ R.T
    step_s = float(np.median(np.diff(imu.stamps_s)))
    gyro_std, rate = noise_and_power(gyro, step_s, imu.gyro_noise_density / np.sqrt(step_s))
    accel_std, _ = noise_and_power(accel, step_s, imu.accel_noise_density / np.sqrt(step_s))
    # A multirotor feels little of its own acceleration in body axes: it leans, and its thrust leans with it.
    level = _levelled(flight, gyro, accel)
    _, acceleration = noise_and_power(level, step_s, accel_std)
    return (
        Series(imu.stamps_s, gyro, np.full(3, gyro_std)),
        Series(imu.stamps_s, accel, np.full(3, accel_std)),
        wander(gyro, rate),
        wander(level, acceleration),
    )


def _levelled(flight: Flight, gyro: Array, accel: Array) -> Array:
    """Specific force (n, 3) with roll and pitch taken out, by the vehicle's own attitude or the gyro's
    sums."""
    imu, attitude = flight.imu, flight.attitude
    assert imu is not None
    if attitude is not None and complete(attitude.roll_pitch_yaw_rad[:, :2]):
        known = np.isfinite(attitude.roll_pitch_yaw_rad[:, :2]).all(axis=1)
        stamps_s, angles = attitude.stamps_s[known], attitude.roll_pitch_yaw_rad[known]
        roll, pitch = (np.interp(imu.stamps_s, stamps_s, angles[:, k]) for k in (0, 1))
    else:
        steps_s = np.diff(imu.stamps_s, prepend=imu.stamps_s[0])
        roll, pitch = np.cumsum(gyro[:, :2] * steps_s[:, None], axis=0).T
    level = rotation_of(np.column_stack([roll, pitch, 0 * roll]))
    return np.asarray(np.einsum("nij,nj->ni", level, accel))


def attitude_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """The vehicle's own attitude; None where there is none."""
    held = flight.attitude
    if held is None or not np.isfinite(held.roll_pitch_yaw_rad).any():
        return None
    std = np.maximum(held.noise_std_rad, trust.attitude_floor_rad)
    return Series(held.stamps_s, held.roll_pitch_yaw_rad, std)


def range_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Ranges within the sensor's limits; None where there is none."""
    held = flight.sonar
    if held is None:
        return None
    inside = (held.range_m >= held.min_range_m) & (held.range_m <= held.max_range_m)
    values = np.where(inside, held.range_m, np.nan)[:, None]
    std = np.array([max(held.noise_std_m, trust.range_floor_m)])
    return Series(held.stamps_s, values, std) if inside.any() else None


def velocity_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Velocity forward and left; None where there is none."""
    held = flight.velocity
    if held is None or not np.isfinite(held.v_m_s).any():
        return None
    return Series(held.stamps_s, held.v_m_s, np.maximum(held.noise_std_m_s, trust.velocity_floor_m_s))


def positions_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """GPS east, north, up of the first fix; its up is missing where no altitude was read."""
    gps, origin = flight.gps, flight.geo_origin()
    if gps is None or origin is None:
        return None
    altitude = np.where(np.isfinite(gps.altitude_m), gps.altitude_m, origin.altitude_m)
    enu = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, altitude, origin)
    enu[~np.isfinite(gps.altitude_m), 2] = np.nan
    std = np.maximum(gps.noise_std_m, trust.gps_floor_m)
    step_s = float(np.median(np.diff(gps.stamps_s))) if len(gps.stamps_s) > 1 else np.inf
    # Fixes whose errors are one error are worth one fix.
    return Series(gps.stamps_s, enu, std * np.sqrt(max(1.0, 2 * trust.gps_time_s / step_s)))


def barometer_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Barometric height; None where there is none."""
    held = flight.barometer
    if held is None or not np.isfinite(held.value).any():
        return None
    return Series(
        held.stamps_s, held.value[:, None], np.array([max(held.noise_std, trust.barometer_floor_m)])
    )


def zeros_at(stamps_s: Array, std: float) -> Series | None:
    """Zeros (n, 3) at some times; None where there are none."""
    return Series(stamps_s, np.zeros((len(stamps_s), 3)), np.full(3, std)) if len(stamps_s) else None
