"""Readings of motion between the keyframes: of an IMU, and of an autopilot's velocity and yaw."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.measurements import nominal_errors

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.80665
"""Standard acceleration of gravity."""


@dataclass(frozen=True)
class InertialReadings:
    """Gyro and accelerometer in body axes; finite, in order of time."""

    stamps_s: Array
    """(k,)."""
    gyro_rad_s: Array
    """(k, 3)."""
    accel_m_s2: Array
    """(k, 3)."""
    accel_clipped: float = 0.0
    """Share of the accelerometer's readings that lie at the end of its range."""


@dataclass(frozen=True)
class InertialNoise:
    """Noise and unknown constants of gyro and accelerometer, as standard deviations."""

    gyro_density: float = 1.5e-3
    """White noise, rad/s/sqrt(Hz)."""
    accel_density: float = 5.0e-2
    """m/s²/sqrt(Hz)."""
    gyro_walk: float = 1e-4
    """Random walk of the bias, rad/s²/sqrt(Hz)."""
    accel_walk: float = nominal_errors.ACCEL_WALK_M_S3
    """m/s³/sqrt(Hz)."""
    gyro_offset_rad_s: float = nominal_errors.GYRO_OFFSET_RAD_S
    accel_offset_m_s2: float = nominal_errors.ACCEL_OFFSET_M_S2
    gain_ratio: float = nominal_errors.ACCEL_GAIN_RATIO
    """Error of the accelerometer's gain on each axis. Half of its variance is common to all axes."""
    gyro_gain_ratio: float = nominal_errors.GYRO_GAIN_RATIO
    """Relative error of the gains of the gyro."""
    arm_m: float = 0.1
    """Error of the position of the accelerometer on the body, on each axis."""
    delay_s: float = 0.0125
    """Delay of the keyframes' stamps behind the readings."""


@dataclass(frozen=True)
class Inertial:
    """Readings of an IMU, to be integrated between the pictures."""

    readings: InertialReadings
    noise: InertialNoise = InertialNoise()
    b_p_imu_m: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) nominal position of the accelerometer in body axes."""
    invalid_s: Array = field(default_factory=lambda: np.zeros(0))
    """Increasing times of readings that are wrong, such as saturated ones."""


class ReportedNoise(NamedTuple):
    """Errors of velocity forward, velocity left and yaw rate: white noise, and an error that fades.

    The error that fades is a Gauss-Markov process. The tuples hold one number for each of the three.
    """

    density: tuple[float, float, float]
    """White noise, m/s/sqrt(Hz) twice and rad/s/sqrt(Hz)."""
    error: tuple[float, float, float]
    """Standard deviation of the error that fades, m/s twice and rad/s."""
    time_s: tuple[float, float, float]
    """Its correlation time."""


NO_REPORTED_NOISE = ReportedNoise((0.0,) * 3, (0.0,) * 3, (1.0,) * 3)


@dataclass(frozen=True)
class ReportedMotion:
    """Readings, finite and in order of time, and their assumed errors."""

    stamps_s: Array
    """(k,) times of the velocities."""
    v_m_s: Array
    """(k, 2) forward and left in level axes along the heading."""
    yaw_stamps_s: Array
    yaw_rad: Array
    """(l,) without jumps by whole turns."""
    noise: ReportedNoise
    """Nominal noise, where the pictures tell too little."""
    gain_std: float = 0.1
    """Relative error that all velocities along an axis share."""
    bias_m_s: float = nominal_errors.VELOCITY_ERROR_M_S
    """Standard deviation of a constant error of the velocity, on each axis."""
    drift_rad_s: float = nominal_errors.GYRO_OFFSET_RAD_S
    """Standard deviation of a constant drift of the yaw."""
    lag_s: float = 0.1
    """Standard deviation of the time by which the velocities are late."""
    tells_turns: bool = True
    """Whether the changes of yaw are measurements; false where a gyro tells them, from which they come."""
