"""The blind tests' quadrotor against closed forms, scipy's integrator and the healthy vehicle's figures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.blind import instruments as seen
from tests.blind.plans import GRID_S, PLANS, stick_of
from tests.blind.vehicle import FULL_TILT, HEALTHY, LEGS, G, Knobs, Path, fly, obeyed, unrest

H = 0.0025


def flown(stick: np.ndarray, z: float = 1.5, yaw: float = 0.0) -> Path:
    """One healthy member without noise."""
    return fly([{}], stick[..., None], np.array([[0.0], [0.0], [z], [yaw]]), None, H)


def restless(seconds: float, members: int, knobs: Knobs, seed: int) -> Path:
    """Hovers side by side."""
    rng, steps = np.random.default_rng(seed), round(seconds / H)
    noise = np.stack([unrest(knobs, steps, H, rng) for _ in range(members)], axis=-1)
    start = np.tile([[0.0], [0.0], [1.5], [0.0]], members)
    return fly([knobs] * members, np.zeros((steps, 4, members)), start, noise, H)


def held(values: tuple[float, float, float, float], seconds: float) -> np.ndarray:
    return np.tile(values, (round(seconds / H), 1))


@pytest.mark.slow
@pytest.mark.parametrize("stick", [0.1, -0.25, 0.4])
def test_terminal_velocity_and_its_time_constant(stick):
    path = flown(held((stick, 0, 0, 0), 20.0), yaw=0.6)
    top = G * np.tan(stick * FULL_TILT) / HEALTHY["drag"]
    v = np.cos(0.6) * path.state[:, 3, 0] + np.sin(0.6) * path.state[:, 4, 0]
    assert v[-1] == pytest.approx(top, rel=1e-4)
    late = np.log(1.0 - v[[2000, 4000]] / top)
    assert (late[0] - late[1]) / (2000 * H) == pytest.approx(HEALTHY["drag"], rel=1e-3)


def test_the_tilt_lags_and_the_speed_to_the_left_is_a_roll_to_the_left():
    path = flown(held((0, 0.3, 0, 0), 1.0))
    t = np.arange(len(path.state)) * H
    expected = -0.3 * FULL_TILT * (1.0 - np.exp(-t / 0.1))
    np.testing.assert_allclose(path.state[:, 6, 0], expected, atol=1e-12)
    assert path.state[-1, 4, 0] > 0.5


def test_climb_and_yaw_follow_their_loops():
    path = flown(held((0, 0, 0.5, -0.4), 2.0))
    t = np.arange(len(path.state)) * H
    np.testing.assert_allclose(path.state[:, 5, 0], 0.5 * (1 - np.exp(-t / 0.3)), atol=1e-5)
    np.testing.assert_allclose(path.state[:, 9, 0], -0.6 * (1 - np.exp(-t / 0.05)), atol=1e-12)
    np.testing.assert_allclose(path.state[:, 8, 0], -0.6 * (t - 0.05 * (1 - np.exp(-t / 0.05))), atol=1e-12)


def test_against_an_integrator_of_scipys():
    """A reversing flight with turns: positions within a tenth of a millimetre."""
    stick = np.repeat(stick_of("reversing_steps", 12.0, np.random.default_rng(3)), 2, axis=0)
    stick[2000:, 3] = 0.3
    path = flown(stick, z=1.5)

    def rate(t: float, y: np.ndarray, s: np.ndarray) -> list[float]:
        _, _, _, vx, vy, vz, roll, pitch, yaw, r = y
        c, n = np.cos(yaw), np.sin(yaw)
        ahead, left = np.tan(pitch), -np.tan(roll) / np.cos(pitch)
        k = G * 0.057
        return [
            vx, vy, vz, G * (c * ahead - n * left) - k * vx, G * (n * ahead + c * left) - k * vy,
            (s[2] - vz) / 0.3, (-s[1] * FULL_TILT - roll) / 0.1, (s[0] * FULL_TILT - pitch) / 0.1,
            r, (1.5 * s[3] - r) / 0.05,
        ]  # fmt: skip

    y = np.array([0, 0, 1.5, 0, 0, 0, 0, 0, 0, 0.0])
    edges = [0, *(np.flatnonzero(np.any(np.diff(stick, axis=0) != 0, axis=1)) + 1), len(stick)]
    for a, b in pairwise(edges):
        y = solve_ivp(rate, (0, (b - a) * H), y, args=(stick[a],), rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(path.state[-1, :3, 0], y[:3], atol=1e-4)
    np.testing.assert_allclose(path.state[-1, 3:6, 0], y[3:6], atol=2e-5)


@pytest.mark.slow
def test_hover_statistics_are_the_healthy_vehicles():
    path = restless(25.0, 16, {}, seed=2)
    # Tilt, turning and speed begin at rest.
    state, noise = path.state[400:], path.noise[400:]
    tilt = HEALTHY["tilt_std"] * np.sqrt(0.25 / (0.25 + 0.10))
    assert np.std(state[:, 6:8]) == pytest.approx(tilt, rel=0.06)
    assert np.std(noise[:, 6:8]) == pytest.approx(0.034, rel=0.05)
    assert np.std(noise[:, 8]) == pytest.approx(0.012, rel=0.08)
    lag = round(0.3 / H)
    correlation = np.mean(noise[lag:, 6] * noise[:-lag, 6]) / np.var(noise[:, 6])
    # Behind the pole: (tau e^(-t/tau) - pole e^(-t/pole)) / (tau - pole).
    assert correlation == pytest.approx((0.12 * np.exp(-2.5) - 0.02 * np.exp(-15)) / 0.1, abs=0.04)
    speed = state[2000:, 3:5] + noise[2000:, 6:8]
    assert 0.045 < np.std(speed) < 0.065
    rest = np.std(state[:, 9])
    assert rest == pytest.approx(HEALTHY["spin_std"] * np.sqrt(0.35 / 0.40), rel=0.08)


def test_the_gyro_and_the_accelerometer_are_derivatives_of_what_moves():
    stick = np.repeat(stick_of("square", 8.0, np.random.default_rng(1)), 2, axis=0)
    path = flown(stick, yaw=1.0)
    t, h = np.linspace(4.0, 7.9, 300), 1e-4
    at = seen.moments(path, 0, t)
    before, after = seen.moments(path, 0, t - h), seen.moments(path, 0, t + h)
    # Away from jumps of the stick both sides agree.
    smooth = np.abs(before.turning - after.turning).max(axis=1) < 0.02
    assert smooth.mean() > 0.9
    turn = (before.w_R_b.inv() * after.w_R_b).as_rotvec() / (2 * h)
    np.testing.assert_allclose(seen.inertial(at)[smooth, :3], turn[smooth], atol=2e-3)
    a = (after.speed - before.speed) / (2 * h) + [0, 0, G]
    np.testing.assert_allclose(seen.inertial(at)[smooth, 3:], at.w_R_b.inv().apply(a)[smooth], atol=0.02)


def test_readings_at_rest_and_under_tilt():
    path = flown(held((0, 0, 0, 0), 1.0))
    at = seen.moments(path, 0, np.array([0.5]))
    np.testing.assert_allclose(seen.inertial(at), [[0, 0, 0, 0, 0, G]], atol=1e-9)
    np.testing.assert_allclose(seen.echo(at), [1.5], atol=1e-9)
    path = flown(held((0.3, -0.2, 0, 0), 3.0))
    at = seen.moments(path, 0, np.array([2.9]))
    roll, pitch, _ = at.angles[0]
    assert seen.echo(at)[0] == pytest.approx(at.place[0, 2] / (np.cos(roll) * np.cos(pitch)), rel=1e-9)


def test_the_roughness_inside_a_step_keeps_the_accelerometers_spread():
    """Readings between the nodes scatter as those at the nodes do."""
    path = restless(12.0, 8, {"shake_tau": 0.05}, seed=4)
    t, rng = np.arange(1.0, 11.9, 0.01), np.random.default_rng(5)

    def rough(part: float) -> float:
        return float(np.std([seen.moments(path, m, t + part * H, rng).acceleration[:, 0] for m in range(8)]))

    spread = rough(0.0), rough(0.5)
    assert spread[0] == pytest.approx(spread[1], rel=0.02)
    assert spread[0] == pytest.approx(0.034 / np.sqrt(0.05 * 0.02), rel=0.06)


def test_a_landing_settles_without_a_bounce():
    stick = np.concatenate([held((0, 0, -0.3, 0), 5.0), held((0.3, 0, -0.3, 0), 1.0)])
    path = flown(stick, z=0.6)
    z = path.state[:, 2, 0]
    down = np.flatnonzero(z < LEGS)[0]
    # Pressed on by the stick until it is let go.
    pressed = LEGS - 0.3 / 0.3 / 2500.0
    np.testing.assert_allclose(z[down + round(0.2 / H) : 2000], pressed, atol=3e-4)
    assert z[down:2000].max() < LEGS + 2e-3
    assert abs(path.state[-1, 3, 0]) < 1e-3


def test_the_queue_delays_by_its_mean():
    stick = np.repeat(stick_of("tilt_pulses", 60.0, np.random.default_rng(2)), 2, axis=0)
    out = obeyed(stick, {"late": 0.08, "late_spread": 0.003}, H, np.random.default_rng(0))
    shift = [np.sum(stick[:-k, 0] * out[k:, 0]) for k in range(1, 80)]
    assert (np.argmax(shift) + 1) * H == pytest.approx(0.08, abs=0.004)


@pytest.mark.parametrize("plan", sorted(PLANS))
def test_plans_stay_in_the_air_and_differ(plan):
    sticks = [stick_of(plan, 40.0, np.random.default_rng(s)) for s in range(6)]
    assert all(s.shape == (round(40.0 / GRID_S), 4) and np.abs(s).max() <= 1.0 for s in sticks)
    if plan != "hover":
        assert not np.array_equal(sticks[0], sticks[1])
    if plan != "touchdown":
        for s in sticks:
            assert 1.0 + GRID_S * np.cumsum(s[:, 2]).min() > 0.5
