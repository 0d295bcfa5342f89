import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.simulation.maneuver import Maneuver, plan
from slam.simulation.vehicle import GRAVITY_M_S2, Vehicle, fly

EXTENT = (-5.0, -5.0, 5.0, 5.0)
CALM = Vehicle(tilt_std_deg=0, altitude_std_m=0, heading_std_deg=0)
SQUARE = Maneuver(((0.0, 0.0), (2.0, 0.0), (2.0, 2.0, 1.3), (0.0, 2.0), (0.0, 0.0)), heading="along_path")
HOVER = Maneuver(((0.0, 0.0),), rest_s=200.0)


def flown(maneuver, vehicle, seed=0):
    return fly(plan(maneuver, {}, EXTENT), vehicle, np.random.default_rng(seed))


def strapdown(motion, steps):
    """Rotation, velocity and position after integrating the IMU's readings alone, by the midpoint rule."""
    t, dt = np.linspace(0, motion.duration_s, steps, endpoint=False), motion.duration_s / steps
    start, force = motion.at(np.zeros(1)), motion.at(t + dt / 2).b_specific_force_m_s2
    turn = Rotation.from_rotvec(motion.at(t + dt / 2).b_rate_rad_s * dt).as_matrix()
    half_turn = Rotation.from_rotvec(motion.at(t + dt / 4).b_rate_rad_s * dt / 2).as_matrix()
    R, v, p = start.w_R_b[0], start.w_v_m_s[0].copy(), start.w_p_m[0].copy()
    for k in range(steps):
        a = R @ half_turn[k] @ force[k] - [0, 0, GRAVITY_M_S2]
        p += v * dt + a * dt * dt / 2
        v += a * dt
        R = R @ turn[k]
    return R, v, p


@pytest.mark.parametrize("seed", range(3))
def test_integrating_gyro_and_accelerometer_gives_the_motion(seed):
    motion = flown(SQUARE, Vehicle(), seed)
    end = motion.at(np.array([motion.duration_s]))
    truth = (end.w_R_b[0], end.w_v_m_s[0], end.w_p_m[0])
    coarse, fine = (
        [np.linalg.norm(found - true) for found, true in zip(strapdown(motion, steps), truth, strict=True)]
        for steps in (4000, 32_000)
    )
    assert fine[0] < 1e-6
    assert fine[1] < 3e-5
    assert fine[2] < 3e-4
    # What is left is the integrator's: it shrinks with the step.
    assert np.all(np.array(fine) < 0.2 * np.array(coarse))


def test_the_tilt_is_what_acceleration_and_drag_ask_for():
    motion = flown(SQUARE, Vehicle(drag_1_s=0.559), 3)
    state = motion.at(np.linspace(0, motion.duration_s, 500))
    R = state.w_R_b
    asked = (state.w_a_m_s2[:, :2] + 0.559 * state.w_v_m_s[:, :2]) / GRAVITY_M_S2
    assert np.allclose(R[:, :2, 2] / R[:, 2, 2, None], asked, atol=1e-12)
    assert np.abs(asked).max() > 0.03


def test_velocity_and_acceleration_are_the_derivatives_of_position():
    motion = flown(SQUARE, Vehicle(), 5)
    t, h = np.linspace(1, motion.duration_s - 1, 200), 1e-4
    before, at, after = motion.at(t - h), motion.at(t), motion.at(t + h)
    assert np.allclose((after.w_p_m - before.w_p_m) / (2 * h), at.w_v_m_s, atol=1e-6)
    assert np.allclose((after.w_v_m_s - before.w_v_m_s) / (2 * h), at.w_a_m_s2, atol=1e-5)


def test_forward_flight_is_nose_down_and_leftward_flight_rolls_left():
    forward = flown(Maneuver(((0.0, 0.0), (4.0, 0.0))), CALM).at(np.array([4.0]))
    left = flown(Maneuver(((0.0, 0.0), (0.0, 4.0))), CALM).at(np.array([4.0]))
    steady = np.arctan(0.559 * 0.5 / GRAVITY_M_S2)
    assert forward.roll_pitch_yaw_rad[0] == pytest.approx([0, steady, 0], abs=1e-9)
    assert left.roll_pitch_yaw_rad[0] == pytest.approx([-steady, 0, 0], abs=1e-9)


def test_a_calm_vehicle_hovers_perfectly():
    state = flown(Maneuver(((1.0, 2.0),), rest_s=5.0), CALM).at(np.linspace(0, 10, 100))
    assert np.allclose(state.w_T_b[:, :3, :3], np.eye(3))
    assert np.allclose(state.w_p_m, [1.0, 2.0, 0.8])
    assert np.allclose(state.b_specific_force_m_s2, [0, 0, GRAVITY_M_S2])


def test_hover_noise_has_the_size_it_is_given_from_the_start_on():
    """Two-sided, on 40 hovers of 400 s: the spread at the first moment and over the whole flight."""
    vehicle = Vehicle()
    first, whole = [], []
    for seed in range(40):
        motion = flown(HOVER, vehicle, seed)
        state = motion.at(np.linspace(0, motion.duration_s, 4000))
        tilt = np.degrees(state.roll_pitch_yaw_rad[:, :2])
        columns = np.column_stack(
            [tilt, state.w_v_m_s[:, :2], state.w_p_m[:, 2] - 0.8, np.degrees(state.roll_pitch_yaw_rad[:, 2])]
        )
        first.append(columns[0])
        whole.append(columns.std(0))
    whole = np.mean(whole, axis=0)
    assert whole[:2] == pytest.approx(0.4, rel=0.06)
    assert np.all((whole[2:4] > 0.025) & (whole[2:4] < 0.040))
    assert whole[4] == pytest.approx(0.012, rel=0.06)
    assert whole[5] == pytest.approx(0.5, rel=0.06)
    # chi-square, 40 degrees of freedom: the 99.9 % band of a ratio of standard deviations
    ratio = np.sqrt(np.mean(np.square(first), axis=0)) / whole
    assert np.all((ratio > 0.62) & (ratio < 1.38))
