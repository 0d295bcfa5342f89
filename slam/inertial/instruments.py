"""Conversion of a flight's streams to readings of the filter, in body axes with their noise.

``InertialTrust`` holds further assumptions on the errors of instruments.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backend.ekf.inputs import Series
from backend.measurements import nominal_errors
from slam.core.errors import InputError, one_line
from slam.core.geodesy import enu_from_geodetic
from slam.core.rotations import rotation_of
from slam.inertial.variogram import CorrelatedProcess, correlated_process, noise_and_power
from slam.inertial.zero_velocity import RestWindows

if TYPE_CHECKING:
    from slam.core.flight import Flight

Array = NDArray[np.float64]

_DEFAULT_RATE, _DEFAULT_ACCEL = CorrelatedProcess(2.0, 1.0), CorrelatedProcess(3.0, 1.0)
"""Process noise of a vehicle without gyro and accelerometer."""


@dataclass(frozen=True)
class InertialTrust:
    """Assumed errors of instruments in addition to their nominal noise, as standard deviations."""

    gyro_offset_rad_s: float = nominal_errors.GYRO_OFFSET_RAD_S
    gyro_walk_rad_s2: float = 1e-3
    """Random walk of the gyro's bias where none is stated, and the least one of the filter, per root Hz."""
    accel_offset_m_s2: float = nominal_errors.ACCEL_OFFSET_M_S2
    accel_walk_m_s3: float = nominal_errors.ACCEL_WALK_M_S3
    """The same of the accelerometer's bias."""
    attitude_floor_rad: float = 0.003
    """Least white noise of the on-board attitude."""
    tilt_error_rad: float = 0.1
    """Correlated error of its tilt; wind and long accelerations caused 8 degrees in an AR.Drone."""
    yaw_walk_rad: float = 0.035
    """Random walk of its yaw, per root second; that of an AR.Drone drifted by 17 degrees in 73 s."""
    range_floor_m: float = nominal_errors.RANGE_FLOOR_M
    velocity_floor_m_s: float = 0.02
    velocity_error_m_s: float = nominal_errors.VELOCITY_ERROR_M_S
    """Correlated error of the velocity besides its scale."""
    gps_floor_m: float = 0.5
    gps_time_s: float = 5.0
    """Correlation time of the errors of fixes."""
    barometer_floor_m: float = nominal_errors.BAROMETER_FLOOR_M
    barometer_walk_m: float = nominal_errors.BAROMETER_WALK_M
    """Random walk of the barometric height, per root second."""
    start_speed_m_s: float = 1.0
    """Standard deviation of the initial velocity without a measurement."""


def complete(values: Array) -> bool:
    """Whether each column of (n, d) holds more than one finite value."""
    return bool((np.isfinite(values).sum(axis=0) > 1).all())


def inertial_of(flight: Flight) -> tuple[Series | None, Series | None, CorrelatedProcess, CorrelatedProcess]:
    """Return gyro and accelerometer in body axes, and the process noise of body rate and acceleration.

    Raises ``InputError`` where one of them has no reading.
    """
    imu = flight.imu
    if imu is None or len(imu.stamps_s) < 2:
        return None, None, _DEFAULT_RATE, _DEFAULT_ACCEL
    for values, word in ((imu.gyro_rad_s, "gyro"), (imu.accel_m_s2, "accelerometer")):
        if not complete(values):
            raise InputError(
                f"{one_line(flight.name)}: the {word} of imu0 has no readings; repair imu0, or leave it out"
            )
    R, moves = imu.b_T_s[:3, :3], RestWindows.of(flight).moves_at(imu.stamps_s)[:, None]
    gyro, accel = imu.gyro_rad_s @ R.T, imu.accel_m_s2 @ R.T
    step_s = float(np.median(np.diff(np.unique(imu.stamps_s))))
    # At rest nothing shows vibration, nor how fast a vehicle moves.
    flown_gyro, flown_accel = (np.where(moves, values, np.nan) for values in (gyro, accel))
    gyro_std, rate = noise_and_power(flown_gyro, step_s, imu.gyro_noise_density / np.sqrt(step_s))
    accel_std, _ = noise_and_power(flown_accel, step_s, imu.accel_noise_density / np.sqrt(step_s))
    # In body axes a multirotor measures little of its acceleration, because its thrust tilts with it.
    level = np.where(moves, _levelled(flight, gyro, accel), np.nan)
    _, acceleration = noise_and_power(level, step_s, accel_std)
    return (
        Series(imu.stamps_s, gyro, np.full(3, gyro_std)),
        Series(imu.stamps_s, accel, np.full(3, accel_std)),
        correlated_process(flown_gyro, rate),
        correlated_process(level, acceleration),
    )


def _levelled(flight: Flight, gyro: Array, accel: Array) -> Array:
    """Return the specific force (n, 3) in level axes, by the on-board attitude or the integrated gyro."""
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
    """Return the on-board attitude, or None."""
    attitude = flight.attitude
    if attitude is None or not np.isfinite(attitude.roll_pitch_yaw_rad).any():
        return None
    std = np.maximum(attitude.noise_std_rad, trust.attitude_floor_rad)
    return Series(attitude.stamps_s, attitude.roll_pitch_yaw_rad, std)


def range_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Return the ranges within the sensor's limits, or None."""
    sonar = flight.sonar
    if sonar is None:
        return None
    inside = (sonar.range_m >= sonar.min_range_m) & (sonar.range_m <= sonar.max_range_m)
    values = np.where(inside, sonar.range_m, np.nan)[:, None]
    std = np.array([max(sonar.noise_std_m, trust.range_floor_m)])
    return Series(sonar.stamps_s, values, std) if inside.any() else None


def velocity_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Return the velocity forward and left, or None."""
    velocity = flight.velocity
    if velocity is None or not np.isfinite(velocity.v_m_s).any():
        return None
    return Series(
        velocity.stamps_s, velocity.v_m_s, np.maximum(velocity.noise_std_m_s, trust.velocity_floor_m_s)
    )


def positions_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Return the GPS positions that the others confirm, east, north and up of the origin; up may be NaN."""
    gps, origin, check = flight.gps, flight.geo_origin(), flight.fix_check()
    if gps is None or origin is None or check is None:
        return None
    altitude = np.where(np.isfinite(gps.altitude_m), gps.altitude_m, origin.altitude_m)
    enu = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, altitude, origin)
    enu[~np.isfinite(gps.altitude_m) | ~check.altitude_consistent, 2] = np.nan
    used = check.consistent
    if not used.any():
        return None
    std = np.maximum(np.hypot(gps.each_std_m[used], gps.antenna_std_m), trust.gps_floor_m)
    return Series(gps.stamps_s[used], enu[used], std * np.sqrt(fixes_of_one_error(gps.stamps_s, trust)))


def fixes_of_one_error(stamps_s: Array, trust: InertialTrust) -> float:
    """Return how many successive fixes at stamps (n,) have one error: they count as one fix."""
    step_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else np.inf
    return max(1.0, 2 * trust.gps_time_s / step_s)


def barometer_of(flight: Flight, trust: InertialTrust) -> Series | None:
    """Return the barometric height, or None."""
    barometer = flight.barometer
    if barometer is None or not np.isfinite(barometer.value).any():
        return None
    return Series(
        barometer.stamps_s,
        barometer.value[:, None],
        np.array([max(barometer.noise_std, trust.barometer_floor_m)]),
    )


def zeros_at(stamps_s: Array, std: float) -> Series | None:
    """Return zeros (n, 3) at the given times, or None without any."""
    return Series(stamps_s, np.zeros((len(stamps_s), 3)), np.full(3, std)) if len(stamps_s) else None
