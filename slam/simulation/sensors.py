"""Instruments: what IMU, attitude and sonar read of a motion, each on its own clock and with its own noise.

Source of the default figures: the healthy vehicle of the criticism flights. Each instrument draws from a
generator of its own, so that adding or changing one leaves the readings of the others as they were.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam.flight import AttitudeSeries, Imu, Sonar
from slam.simulation.vehicle import Motion

Array = NDArray[np.float64]
Rate = Annotated[float, Field(gt=0, le=2000)]
Noise = Annotated[float, Field(ge=0, le=100)]

LATEST_START_S = 0.25
"""Each stream takes its first sample within this time."""


@dataclass(frozen=True)
class ImuModel:
    """Gyro and accelerometer with white noise."""

    rate_hz: Rate = 100.0
    gyro_noise_density: Noise = 1.5e-3
    """rad/s/sqrt(Hz)."""
    accel_noise_density: Noise = 5.0e-2
    """m/s^2/sqrt(Hz)."""


@dataclass(frozen=True)
class AttitudeModel:
    """The vehicle's own attitude with white noise."""

    rate_hz: Rate = 50.0
    noise_std_deg: Noise = 0.5


@dataclass(frozen=True)
class SonarModel:
    """Slant range to the floor along the body's -z axis."""

    rate_hz: Rate = 25.0
    noise_std_m: Noise = 0.01
    datum_m: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """Added to every range: the error of its zero."""
    min_range_m: Annotated[float, Field(ge=0)] = 0.25
    max_range_m: Annotated[float, Field(gt=0)] = 6.0


def generator(seed: int, stream: str, *index: int) -> np.random.Generator:
    """The random numbers of one stream of one flight, independent of those of every other."""
    return np.random.default_rng((seed, zlib.crc32(stream.encode()), *index))


def stamps(rate_hz: float, duration_s: float, rng: np.random.Generator) -> Array:
    """(n,) regular stamps, in whole nanoseconds, from a drawn first one to the end of the flight; n >= 1."""
    first = rng.uniform(0.0, min(LATEST_START_S, duration_s))
    count = int((duration_s - first) * rate_hz) + 1
    return np.round(first + np.arange(count) / rate_hz, 9)


def read_imu(motion: Motion, model: ImuModel, rng: np.random.Generator) -> Imu:
    """Body rates and specific force."""
    state = motion.at(stamps(model.rate_hz, motion.duration_s, rng))
    per_sample = np.sqrt(model.rate_hz)
    gyro, accel = state.b_rate_rad_s, state.b_specific_force_m_s2
    return Imu(
        state.stamps_s,
        gyro + rng.normal(0.0, model.gyro_noise_density * per_sample, gyro.shape),
        accel + rng.normal(0.0, model.accel_noise_density * per_sample, accel.shape),
        model.gyro_noise_density,
        model.accel_noise_density,
    )


def read_attitude(motion: Motion, model: AttitudeModel, rng: np.random.Generator) -> AttitudeSeries:
    """True roll, pitch and yaw with noise."""
    state = motion.at(stamps(model.rate_hz, motion.duration_s, rng))
    std = float(np.radians(model.noise_std_deg))
    angles = state.roll_pitch_yaw_rad
    return AttitudeSeries(state.stamps_s, angles + rng.normal(0.0, std, angles.shape), (std, std, std))


def read_sonar(motion: Motion, model: SonarModel, rng: np.random.Generator) -> Sonar:
    """Height over the cosine of the tilt; NaN where that is out of range."""
    state = motion.at(stamps(model.rate_hz, motion.duration_s, rng))
    roll, pitch, _ = state.roll_pitch_yaw_rad.T
    slant = state.w_p_m[:, 2] / (np.cos(pitch) * np.cos(roll))
    range_m = slant + model.datum_m + rng.normal(0.0, model.noise_std_m, slant.shape)
    range_m[(range_m < model.min_range_m) | (range_m > model.max_range_m)] = np.nan
    # Its scale is exact, and it says so.
    return Sonar(
        state.stamps_s, range_m, model.noise_std_m, model.min_range_m, model.max_range_m, scale_std=0.0
    )
