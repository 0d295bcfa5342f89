"""A map that another instrument contradicts grossly says so; noise, gains and delays are no matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.flight import Flight
from slam.mapping.warnings.contradictions import contradictions
from slam.mapping.warnings.motions import KeyframeSteps
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe

STEP_S = 0.3


@pytest.fixture(scope="module")
def flight() -> Flight:
    recipe = load_recipe("figure_eight_heights")
    return simulate(replace(recipe, camera=None), seed=4)


def lines_of(steps):
    return list(map(str, contradictions(steps)))


def told(flight: Flight, metric: bool = True, backwards: bool = False) -> list[str]:
    """The true way as a map."""
    assert flight.truth is not None
    at = np.searchsorted(flight.truth.stamps_s, np.arange(1.0, flight.truth.stamps_s[-1] - 1.0, STEP_S))
    poses = flight.truth.w_T_b[at]
    poses[5] = np.nan
    return lines_of(
        KeyframeSteps.of(flight, flight.truth.stamps_s[at], poses[::-1] if backwards else poses, metric)
    )


def test_a_healthy_flight_is_not_contradicted(flight: Flight):
    assert told(flight) == []


def test_neither_noise_nor_gain_nor_delay_contradicts(flight: Flight):
    read, attitude = flight.velocity, flight.attitude
    slow = replace(read, v_m_s=0.75 * read.v_m_s, stamps_s=read.stamps_s + 0.05)
    noise = np.random.default_rng(1).normal(0.0, np.radians(0.5), attitude.roll_pitch_yaw_rad.shape)
    rough = replace(attitude, roll_pitch_yaw_rad=attitude.roll_pitch_yaw_rad + noise)
    assert told(replace(flight, velocity=slow, attitude=rough)) == []


def test_half_a_turn_has_no_direction(flight: Flight):
    """On lanes there and back the yaw turns by half a turn between two pictures, to one side or the other."""
    stamps_s = np.arange(20) * 1.0
    heading = np.pi * (np.arange(20) // 4 % 2)
    rng = np.random.default_rng(3)
    read, made = (np.column_stack([np.zeros((20, 2)), heading + rng.normal(0, 0.03, 20)]) for _ in range(2))
    read = np.angle(np.exp(1j * read))
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("ZYX", made[:, ::-1]).as_matrix()
    attitude = replace(flight.attitude, stamps_s=stamps_s, roll_pitch_yaw_rad=read)
    alone = replace(flight, imu=None, velocity=None, sonar=None, attitude=attitude)
    assert contradictions(KeyframeSteps.of(alone, stamps_s, poses, True)) == []


def test_an_attitude_that_hardly_knows_contradicts_nothing(flight: Flight):
    read = flight.attitude
    noise = np.random.default_rng(2).normal(0.0, np.radians(3.0), read.roll_pitch_yaw_rad.shape)
    vague = replace(
        read, roll_pitch_yaw_rad=read.roll_pitch_yaw_rad + noise, noise_std_rad=(np.radians(3.0),) * 3
    )
    assert told(replace(flight, attitude=vague)) == []


def test_signs_of_the_attitude_are_reported(flight: Flight):
    turned = flight.attitude.roll_pitch_yaw_rad * [-1.0, -1.0, 1.0]
    (line,) = told(replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=turned)))
    assert line.startswith(
        "attitude0 (roll, pitch): opposite in sign to the motion seen in the pictures (correlation -"
    )


def test_pictures_in_another_order_are_reported(flight: Flight):
    lines = told(flight, backwards=True)
    assert any("motion seen in the pictures" in line and line.startswith("velocity0: ") for line in lines)
    assert any("motion seen in the pictures" in line and line.startswith("imu0 (gyro): ") for line in lines)
    assert lines[0].startswith(
        "cam0: imu0 and attitude0 and velocity0 contradict the pictures; check first which"
    )


@pytest.mark.parametrize("keyframes", [8, 12])
def test_stretches_of_few_keyframes_are_compared_too(flight: Flight, keyframes: int):
    """A map of nine keyframes from pictures in the reverse order was ok."""
    stretches = [np.arange(begin, begin + 0.6 * keyframes, 0.6) for begin in np.arange(2.0, 40.0, 4.0)]
    found = 0
    for at_s in stretches:
        at = np.searchsorted(flight.truth.stamps_s, at_s)
        stamps_s, poses = flight.truth.stamps_s[at], flight.truth.w_T_b[at]
        assert contradictions(KeyframeSteps.of(flight, stamps_s, poses, True)) == []
        found += any(
            line.startswith("velocity0")
            for line in lines_of(KeyframeSteps.of(flight, stamps_s, poses[::-1], True))
        )
    assert found >= 0.7 * len(stretches), "round a corner the way back looks alike"


def test_one_instrument_that_contradicts_leaves_the_camera_undoubted(flight: Flight):
    turned = flight.velocity.v_m_s * [1.0, -1.0]
    lines = told(replace(flight, velocity=replace(flight.velocity, v_m_s=-turned)))
    assert len(lines) == 1


def test_a_gyro_that_is_stuck_is_reported(flight: Flight):
    still = replace(flight.imu, gyro_rad_s=np.zeros_like(flight.imu.gyro_rad_s))
    assert told(replace(flight, imu=still)) == [
        "imu0 (gyro): reads no motion while the pictures show some; check whether the sensor is stuck"
    ]


def test_steps_across_a_gap_in_the_readings_are_not_compared(flight: Flight):
    """A line bridged a gap of 3 s, and a good gyro seemed to turn 0.66 times as far."""
    kept = {name: np.abs(getattr(flight, name).stamps_s - 12.0) > 1.5 for name in ("imu", "velocity")}
    imu, velocity = flight.imu, flight.velocity
    imu = replace(
        imu,
        stamps_s=imu.stamps_s[kept["imu"]],
        gyro_rad_s=imu.gyro_rad_s[kept["imu"]],
        accel_m_s2=imu.accel_m_s2[kept["imu"]],
    )
    velocity = replace(
        velocity,
        stamps_s=velocity.stamps_s[kept["velocity"]],
        v_m_s=velocity.v_m_s[kept["velocity"]],
    )
    at = np.searchsorted(flight.truth.stamps_s, np.arange(1.0, 30.0, STEP_S))
    stamps_s, poses = flight.truth.stamps_s[at], flight.truth.w_T_b[at]
    steps = KeyframeSteps.of(replace(flight, imu=imu, velocity=velocity), stamps_s, poses, True)
    within = (stamps_s[:-1] > 11.0) & (stamps_s[1:] < 13.0)
    judged = [motion for motion in steps.motions if motion.stream in ("imu0", "velocity0")]
    assert len(judged) == 3
    for motion in judged:
        assert np.isnan(motion.read[within]).all()
        assert np.isfinite(motion.read[stamps_s[1:] < 10.0][1:]).all()
    assert contradictions(steps) == []


def test_a_unit_is_reported_where_lengths_are_metres(flight: Flight):
    read = replace(flight, velocity=replace(flight.velocity, v_m_s=100.0 * flight.velocity.v_m_s))
    (line,) = told(read)
    assert line.startswith("velocity0: the path on the map is 0.01 times as long as this sensor says")
    assert told(read, metric=False) == []


def test_a_gyro_in_degrees_is_told(flight: Flight):
    degrees = replace(flight.imu, gyro_rad_s=np.degrees(flight.imu.gyro_rad_s))
    (line,) = told(replace(flight, imu=degrees))
    assert line.startswith("imu0 (gyro): turns 57 times as far as the pictures show; check its unit")
    biased = replace(flight.imu, gyro_rad_s=flight.imu.gyro_rad_s + [0.01, -0.01, 0.01])
    assert told(replace(flight, imu=biased)) == []


def test_an_imu_that_is_mounted_upside_down_is_read_in_body_axes(flight: Flight):
    axes = np.array([1, -1, -1])
    below = {"gyro_rad_s": flight.imu.gyro_rad_s * axes, "accel_m_s2": flight.imu.accel_m_s2 * axes}
    assert told(replace(flight, imu=replace(flight.imu, **below, b_T_s=np.diag([1.0, -1, -1, 1])))) == []
    assert told(replace(flight, imu=replace(flight.imu, **below)))


def test_streams_of_nothing_are_survived(flight: Flight):
    lost = replace(
        flight,
        velocity=replace(flight.velocity, v_m_s=np.full_like(flight.velocity.v_m_s, np.nan)),
        imu=replace(
            flight.imu,
            stamps_s=flight.imu.stamps_s[:1],
            gyro_rad_s=flight.imu.gyro_rad_s[:1],
            accel_m_s2=flight.imu.accel_m_s2[:1],
        ),
    )
    assert told(lost) == []


def test_heights_that_alternate_contradict_the_accelerometer(flight: Flight):
    """Pictures of two zooms in turn put the vehicle now here, now a third higher."""
    at = np.searchsorted(flight.truth.stamps_s, np.arange(1.0, flight.truth.stamps_s[-1] - 1.0, STEP_S))
    stamps_s, poses = flight.truth.stamps_s[at], flight.truth.w_T_b[at].copy()
    assert contradictions(KeyframeSteps.of(flight, stamps_s, poses, True)) == []
    poses[::2, 2, 3] *= 4 / 3
    (line,) = lines_of(KeyframeSteps.of(flight, stamps_s, poses, True))
    assert line.startswith("imu0 (vertical acceleration): ")
    assert contradictions(KeyframeSteps.of(flight, stamps_s, poses, False)) == [], "no metres, no heights"


def test_a_step_over_a_gap_of_the_accelerometer_alone_tells_no_climb(flight: Flight):
    """Its readings are missing between two keyframes, those of the gyro are not."""
    truth, imu = flight.truth, flight.imu
    at = np.searchsorted(truth.stamps_s, np.arange(1.0, 12.0, 0.9))
    begin_s = truth.stamps_s[at][:-1]
    lost = (imu.stamps_s > begin_s[4] + 0.05) & (imu.stamps_s < begin_s[5] - 0.05)
    accel_m_s2 = np.where(lost[:, None], np.nan, imu.accel_m_s2)
    gappy = replace(flight, imu=replace(imu, accel_m_s2=accel_m_s2))
    motions = KeyframeSteps.of(gappy, truth.stamps_s[at], truth.w_T_b[at], True).motions
    (climbs,) = (motion for motion in motions if motion.by_acceleration)
    assert np.flatnonzero(np.isnan(climbs.read[:, 0])).tolist() == [0, 4, 5]
