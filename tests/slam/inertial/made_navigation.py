"""A flight of the back end's made motion, as a flight with streams and truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backend.ekf.inputs import FilterModel
from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Imu, Sonar, Truth, Velocity
from tests.backend.made_motion import Noise, fly, read

RATE_HZ = 100.0
AS_MADE = FilterModel(
    gyro_offset_rad_s=0.0,
    accel_offset_m_s2=0.0,
    tilt_error_rad=0.0,
    yaw_walk_rad=0.0,
    range_scale=0.0,
    range_offset_m=0.0,
    velocity_scale=0.0,
)


def made_flight(
    seed: int, seconds: float = 20.0, late_s: float = 0.0, model: FilterModel = AS_MADE
) -> Flight:
    """A flight with truth; its velocity is stamped ``late_s`` after its moment."""
    rng = np.random.default_rng(seed)
    path, noise = fly(rng), Noise()
    readings = read(path, model, rng, seconds, RATE_HZ, noise, yaw_zero_rad=0.0)
    gyro, accel, angles = readings.gyro_rad_s, readings.accel_m_s2, readings.roll_pitch_yaw_rad
    assert gyro is not None and accel is not None and angles is not None  # noqa: PT018
    assert readings.range_m is not None
    assert readings.velocity_m_s is not None
    t = np.arange(0.0, seconds + 0.01, 0.01)
    density = 1 / np.sqrt(RATE_HZ)
    return Flight(
        name="made",
        imu=Imu(gyro.stamps_s, gyro.values, accel.values, noise.gyro * density, noise.accel * density),
        attitude=AttitudeSeries(angles.stamps_s, angles.values, (noise.angle,) * 3),
        sonar=Sonar(readings.range_m.stamps_s, readings.range_m.values[:, 0], noise.range_m, scale_std=0.0),
        velocity=Velocity(
            readings.velocity_m_s.stamps_s + late_s,
            readings.velocity_m_s.values,
            (noise.velocity,) * 2,
            scale_std=0.0,
        ),
        truth=Truth(t, path.w_T_b(t), path.position.at(t, 1)),
    )


def without(flight: Flight, *names: str) -> Flight:
    """The flight without some streams."""
    return replace(flight, **dict.fromkeys(names))
