"""A flown motion against independent strapdown integration, its own derivatives, and smaller steps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from backend.measurements import GRAVITY_M_S2
from slam.simulation.dynamics import STEP_S, integrate
from slam.simulation.model import Model
from slam.simulation.motion import Motion, at_rest, draw_model_noise, simulate_motion, step_count
from slam.simulation.stick import Stick

MODEL = Model()


def drawn_stick(seed, duration_s=12.0):
    """Steps of all axes at odd times, as a person's hand gives them."""
    rng = np.random.default_rng((seed, 1))
    stamps = np.sort(rng.uniform(0.0, duration_s, 30))
    return Stick(stamps, rng.uniform(-0.25, 0.25, (30, 4)) * [1, 1, 0.3, 1], duration_s)


def flown(seed=0, model=MODEL, stick=None):
    stick = stick or drawn_stick(seed)
    rngs = np.random.default_rng((seed, 2)), np.random.default_rng((seed, 3))
    return simulate_motion(
        stick, model, at_rest(1, 2, 3, 0.7), draw_model_noise(model, step_count(stick.duration_s), rngs)
    )


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


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_integrating_gyro_and_accelerometer_gives_the_motion(seed):
    # Changes of the stick between two of the strapdown's steps: it could not know of one inside a step.
    stick = drawn_stick(seed)
    motion = flown(seed, stick=Stick(np.arange(30) * 0.4, stick.values, 12.0))
    end = motion.at(np.array([motion.duration_s]))
    truth = (end.w_R_b[0], end.w_v_m_s[0], end.w_p_m[0])
    coarse, fine = (
        [np.linalg.norm(found - true) for found, true in zip(strapdown(motion, steps), truth, strict=True)]
        for steps in (6000, 24_000)
    )
    assert fine[0] < 1e-6
    assert fine[1] < 1e-4
    assert fine[2] < 1e-3
    # What is left of the turning is the integrator's: of second order in its step.
    assert fine[0] < 0.1 * coarse[0]


def test_velocity_and_acceleration_are_the_derivatives_of_position():
    motion = flown(5)
    t, h = np.linspace(1, motion.duration_s - 1, 200), 2e-5
    near = np.abs(t[:, None] - motion.stick.stamps_s).min(1) < 2 * h
    node = np.abs(t / STEP_S - np.round(t / STEP_S)) < 0.05
    t = t[~near & ~node]
    before, at, after = motion.at(t - h), motion.at(t), motion.at(t + h)
    assert len(t) > 100
    assert np.allclose((after.w_p_m - before.w_p_m) / (2 * h), at.w_v_m_s, atol=1e-4)
    # The velocity noise is linear between the nodes, its rate the pole's: equal but for the pole's curvature.
    slope = (after.w_v_m_s - before.w_v_m_s) / (2 * h)
    assert np.sqrt(np.mean((slope - at.w_a_m_s2) ** 2)) < 0.1


def test_the_readings_are_continuous_across_the_nodes():
    motion = flown(3)
    nodes = np.arange(1, step_count(motion.duration_s) - 1) * STEP_S
    nodes = nodes[np.abs(nodes[:, None] - motion.stick.stamps_s).min(1) > STEP_S]
    before, after = motion.at(nodes - 1e-9), motion.at(nodes)
    for name in ("w_p_m", "w_v_m_s", "roll_pitch_yaw_rad", "b_rate_rad_s", "w_a_m_s2"):
        assert np.abs(getattr(before, name) - getattr(after, name)).max() < 2e-6


def test_beyond_its_ends_a_motion_is_as_at_its_ends():
    motion = flown(1)
    beyond, ends = motion.at(np.array([-1.0, 99.0])), motion.at(np.array([0.0, motion.duration_s]))
    assert np.array_equal(beyond.w_T_b, ends.w_T_b)


def test_the_heading_frame_takes_the_yaw_out_and_nothing_else():
    state = flown(2).at(np.linspace(0, 12, 50))
    turned = np.einsum("nij,nj->ni", Rotation.from_euler("z", state.roll_pitch_yaw_rad[:, 2:]).as_matrix(),
                       np.column_stack([state.h_v_m_s, state.w_v_m_s[:, 2]]))  # fmt: skip
    assert np.allclose(turned, state.w_v_m_s)


SIGMA = {
    "gyro": 1.5e-3 * np.sqrt(200), "accel": 5e-2 * np.sqrt(200), "attitude": np.radians(0.3),
    "velocity": 0.03, "height": 0.01,
}  # fmt: skip


def readings(motion, t):
    state = motion.at(t)
    return {
        "gyro": state.b_rate_rad_s,
        "accel": state.b_specific_force_m_s2,
        "attitude": state.roll_pitch_yaw_rad,
        "velocity": state.h_v_m_s,
        "height": state.w_p_m[:, 2:],
    }


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("term", ["none", "asymmetric_drag", "control_latency"])
def test_halving_the_step_changes_no_reading_by_a_noticeable_share_of_its_noise(seed, term):
    """The numerics gate: 0.3 sigma would be seen; the same noise path, the same odd stick times."""
    model = {
        "none": MODEL,
        "asymmetric_drag": MODEL.with_term("asymmetric_drag", alpha=0.5),
        "control_latency": MODEL.with_term("control_latency", T=0.0833),
    }[term]
    coarse = flown(seed, model)
    t = np.arange(0.2, coarse.duration_s, 1 / 200)
    nodes = np.arange(2 * len(coarse.states) - 1) * STEP_S / 2
    grid = np.arange(len(coarse.states)) * STEP_S
    noise = type(coarse.noise)(*(
        np.column_stack([np.interp(nodes, grid, column) for column in part.T])
        for part in (coarse.noise.values, coarse.noise.rates)
    ))  # fmt: skip
    command = coarse.stick.mean(nodes[:-1], nodes[1:], coarse.latency_s)
    states = integrate(
        coarse.states[:1], command[None], noise.values[None], coarse.parameters[None], STEP_S / 2
    )[0]
    fine = Motion(
        states, noise, coarse.stick, coarse.parameters, coarse.latency_s, coarse.duration_s, 0.0, STEP_S / 2
    )
    a, b = readings(coarse, t), readings(fine, t)
    for name, sigma in SIGMA.items():
        off = (a[name] - b[name]) / sigma
        assert np.abs(off).max() < 0.02, name
        # Over all samples of a flight: the whole difference is a small share of one sigma.
        assert np.sqrt(np.sum(off**2)) < 0.1, name


def test_a_part_of_a_flight_is_the_flight_from_there_on():
    model = MODEL.with_term("control_latency", T=0.05).with_term("battery_sag", loss=0.2)
    whole = simulate_motion(drawn_stick(6), model, at_rest(0, 0, 2, 0))
    part = simulate_motion(whole.stick, model, whole.states[2000], begin_s=4.0, end_s=9.0)
    assert np.abs(part.states - whole.states[2000:4501]).max() < 1e-9
    t = np.linspace(4.0, 9.0, 77)
    assert np.abs(part.at(t).w_T_b - whole.at(t).w_T_b).max() < 1e-9
    assert np.abs(part.at(t).b_rate_rad_s - whole.at(t).b_rate_rad_s).max() < 1e-7


def test_a_late_vehicle_flies_the_same_later():
    stick = drawn_stick(4)
    late = simulate_motion(stick, MODEL.with_term("control_latency", T=0.137), at_rest(0, 0, 2, 0))
    plain = simulate_motion(stick, MODEL, at_rest(0, 0, 2, 0))
    t = np.linspace(0.5, 11.5, 60)
    assert np.abs(late.at(t + 0.137).w_T_b - plain.at(t).w_T_b).max() < 1e-5


def test_hover_jitters_as_much_as_the_healthy_vehicle():
    """Two-sided: 0.25 to 0.43 degrees of tilt, and 0.05 to 0.06 m/s an axis once speed has built up."""
    stick = Stick(np.zeros(1), np.zeros((1, 4)), 60.0)
    tilt, speed = [], []
    for seed in range(12):
        states = flown(seed, stick=stick).at(np.arange(10, 60, 0.02))
        tilt.append(np.degrees(states.roll_pitch_yaw_rad[:, :2]).std())
        speed.append(np.sqrt(np.mean(states.w_v_m_s[:, :2] ** 2)))
    assert 0.25 < np.mean(tilt) < 0.43
    assert 0.045 < np.mean(speed) < 0.065


def test_without_noise_the_vehicle_hovers_perfectly():
    motion = simulate_motion(Stick(np.zeros(1), np.zeros((1, 4)), 35.0), MODEL, at_rest(1, 2, 0.8, 0.4))
    assert np.all(motion.states == motion.states[0])
    state = motion.at(np.linspace(0, 35, 40))
    assert np.allclose(state.b_specific_force_m_s2, [0, 0, GRAVITY_M_S2], atol=1e-12)
