"""Motion that a vehicle reports, as the refinement takes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.core.flight import AttitudeSeries, Flight, Imu, Velocity
from slam.mapping.config import PipelineConfig
from slam.mapping.inertial.measurements import reported_motion

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
