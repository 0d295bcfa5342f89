"""Readings of the IMU, and motion that a vehicle reports, as the refinement takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.flight import Flight
from slam.core.streams import AttitudeSeries, Imu, Velocity
from slam.mapping.config import PipelineConfig
from slam.mapping.inertial.measurements import inertial_measurements, reported_motion

T = np.arange(0.0, 2.0, 0.1)
ANGLES = np.column_stack([0 * T, 0 * T, 3.0 + T])
FLIGHT = Flight(
    "reported",
    attitude=AttitudeSeries(T, (ANGLES + np.pi) % (2 * np.pi) - np.pi),
    velocity=Velocity(T, np.column_stack([T, -T]), scale_std=0.05),
)


def test_unknown_readings_and_whole_turns_are_taken_out():
    assert FLIGHT.velocity is not None
    v_m_s = FLIGHT.velocity.v_m_s.copy()
    v_m_s[3, 1] = np.nan
    motion = reported_motion(
        replace(FLIGHT, velocity=replace(FLIGHT.velocity, v_m_s=v_m_s)), PipelineConfig()
    )
    assert motion is not None
    np.testing.assert_allclose(motion.stamps_s, np.delete(T, 3))
    np.testing.assert_allclose(np.diff(motion.yaw_rad), 0.1)
    assert motion.gain_std == 0.05
    assert motion.tells_turns


def test_turns_are_told_by_the_gyro_where_there_is_one():
    imu = Imu(T, np.zeros((len(T), 3)), np.zeros((len(T), 3)))
    motion = reported_motion(replace(FLIGHT, imu=imu), PipelineConfig())
    assert motion is not None
    assert not motion.tells_turns


def test_a_velocity_without_a_heading_or_of_one_axis_is_no_motion():
    assert FLIGHT.velocity is not None
    half = np.column_stack([T, np.nan * T])
    one_axis = replace(FLIGHT, velocity=replace(FLIGHT.velocity, v_m_s=half))
    for flight in (replace(FLIGHT, attitude=None), replace(FLIGHT, velocity=None), one_axis):
        assert reported_motion(flight, PipelineConfig()) is None


def still_imu(rate_hz: float = 200.0, lasts_s: float = 20.0) -> Imu:
    """An IMU at rest with the noise that it states."""
    rng, t = np.random.default_rng(0), np.arange(0.0, lasts_s, 1 / rate_hz)
    gyro = rng.normal(0, 1e-3 * np.sqrt(rate_hz), (len(t), 3))
    accel = rng.normal([0, 0, 9.81], 1e-2 * np.sqrt(rate_hz), (len(t), 3))
    return Imu(t, gyro, accel, gyro_noise_density=1e-3, accel_noise_density=1e-2)


def test_readings_at_the_end_of_the_range_are_invalid():
    imu = still_imu()
    turning = np.exp(-(((imu.stamps_s - 10.0) / 0.25) ** 2))
    gyro = np.clip(imu.gyro_rad_s + 6.0 * turning[:, None] * [0, 0, 1], -4.363, 4.363)
    measured = inertial_measurements(replace(imu, gyro_rad_s=gyro), PipelineConfig())
    assert measured is not None
    np.testing.assert_array_equal(measured.invalid_s, imu.stamps_s[gyro[:, 2] == 4.363])
    assert len(measured.invalid_s) > 10
    within = inertial_measurements(imu, PipelineConfig())
    assert within is not None
    assert len(within.invalid_s) == 0


def test_vibration_is_no_white_noise():
    """It cancels between two pictures: taken for noise, the accelerometer would count fifty times less."""
    imu = still_imu()
    wander = np.cumsum(np.random.default_rng(1).normal(0, 0.07, len(imu.stamps_s)))
    shaken = imu.accel_m_s2 + 3.0 * np.sin(2 * np.pi * 83.0 * imu.stamps_s + wander)[:, None]
    measured = inertial_measurements(replace(imu, accel_m_s2=shaken), PipelineConfig())
    assert measured is not None
    assert measured.noise.accel_density < 0.05
    rng = np.random.default_rng(2)
    noisy = imu.accel_m_s2 + rng.normal(0, 0.1 * np.sqrt(200), shaken.shape)
    measured = inertial_measurements(replace(imu, accel_m_s2=noisy), PipelineConfig())
    assert measured is not None
    assert 0.09 < measured.noise.accel_density < 0.11


def test_a_stated_walk_of_a_bias_is_taken_as_it_is():
    config = PipelineConfig()
    stated = inertial_measurements(replace(still_imu(), gyro_random_walk=2e-5), config)
    unstated = inertial_measurements(still_imu(), config)
    assert stated is not None
    assert unstated is not None
    assert stated.noise.gyro_walk == 2e-5
    assert unstated.noise.gyro_walk == config.inertial.gyro_walk_rad_s2
