"""The equations of motion against closed forms, against scipy's integrator, and under smaller steps."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slam.simulation.dynamics import (
    COMMAND,
    GRAVITY_M_S2,
    NOISE,
    PARAMETERS,
    STATE,
    STEP_S,
    Moments,
    derivative,
    integrate,
    read_out,
)
from slam.simulation.model import Model, load_model

NOMINAL = load_model("nominal")


def start(z=1.0, **values):
    state = np.zeros(len(STATE))
    state[2] = z
    for name, value in values.items():
        state[STATE.index(name)] = value
    return state


def rate(model, state, noise=(), **command):
    u, out, n = np.zeros(len(COMMAND)), np.empty(len(STATE)), np.zeros(len(NOISE))
    u[4] = float(command.get("forward", 0) == 0 and command.get("left", 0) == 0)
    for name, value in command.items():
        u[COMMAND.index(name)] = value
    n[: len(noise)] = noise
    derivative(state, u, n, model.parameters(), out)
    return dict(zip(STATE, out, strict=True))


def flown(model, duration_s, state=None, step_s=STEP_S, **command):
    steps = round(duration_s / step_s)
    u = np.zeros((1, steps, len(COMMAND)))
    u[..., 4] = float(command.get("forward", 0) == 0 and command.get("left", 0) == 0)
    for name, value in command.items():
        u[0, :, COMMAND.index(name)] = value
    noise = np.zeros((1, steps + 1, len(NOISE)))
    state = start() if state is None else state
    return integrate(state[None], u, noise, model.parameters()[None], step_s)[0]


def test_the_nominal_equations_written_out_by_rotation_matrices():
    """R13 / R33 and R23 / R33 from scipy's rotation matrix, at drawn states."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(0)
    for _ in range(50):
        roll, pitch, yaw = rng.uniform([-0.6, -0.6, -4], [0.6, 0.6, 4])
        v, r = rng.normal(size=3), rng.normal()
        f, left, u, y = rng.uniform(-1, 1, 4)
        n = rng.normal(0, 0.01, 6)
        state = start(v_x=v[0], v_y=v[1], v_z=v[2], roll=roll, pitch=pitch, yaw=yaw, yaw_rate=r)
        found = rate(NOMINAL, state, n, forward=f, left=left, up=u, yaw=y)
        R = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        k, a, g = 0.559, 0.5236, 9.80665
        expected = {
            "x": v[0] + n[3], "y": v[1] + n[4], "z": v[2] + n[5],
            "v_x": g * R[0, 2] / R[2, 2] - k * v[0], "v_y": g * R[1, 2] / R[2, 2] - k * v[1],
            "v_z": (u - v[2]) / 0.30,
            "roll": (-left * a + n[0] - roll) / 0.10, "pitch": (f * a + n[1] - pitch) / 0.10,
            "yaw": r, "yaw_rate": (1.5 * y + n[2] - r) / 0.05,
        }  # fmt: skip
        assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-12)


def test_each_axis_answers_in_its_sense():
    end = {
        name: dict(zip(STATE, flown(NOMINAL, 1.0, **{name: 0.2})[-1], strict=True)) for name in COMMAND[:4]
    }
    assert end["forward"]["x"] > 0.2
    assert end["forward"]["pitch"] > 0
    assert abs(end["forward"]["y"]) < 1e-12
    assert end["left"]["y"] > 0.2
    assert end["left"]["roll"] < 0
    assert end["up"]["z"] > 1.1
    assert end["yaw"]["yaw"] > 0.2


def test_a_step_of_the_stick_follows_the_closed_form():
    """Tilt, and with small angles the speed too: two first-order lags in a row."""
    model = Model(vehicle=Model().vehicle.__class__(small_angle=True))
    states = flown(model, 3.0, forward=0.2)
    t = np.arange(len(states)) * STEP_S
    tilt, tau, k = 0.2 * 0.5236, 0.10, 0.559
    assert np.abs(states[:, STATE.index("pitch")] - tilt * (1 - np.exp(-t / tau))).max() < 1e-8
    c = GRAVITY_M_S2 * tilt
    v = c / k * (1 - np.exp(-k * t)) - c / (1 / tau - k) * (np.exp(-k * t) - np.exp(-t / tau))
    assert np.abs(states[:, STATE.index("v_x")] - v).max() < 1e-7


@pytest.mark.parametrize("seed", range(3))
def test_integration_agrees_with_scipys(seed):
    rng = np.random.default_rng(seed)
    model = NOMINAL.with_term("quadratic_drag", c=0.1).with_term("steady_wind", x=0.4, y=-0.3)
    command = dict(zip(COMMAND[:4], rng.uniform(-0.4, 0.4, 4), strict=True))
    command["up"] = 0.1
    u = np.array([*command.values(), 0.0, 0.0])
    parameters, noise = model.parameters(), rng.normal(0, 0.01, len(NOISE))

    def f(t, x):
        out = np.empty(len(STATE))
        derivative(x, u, noise, parameters, out)
        return out

    exact = solve_ivp(f, (0, 2.0), start(v_x=0.5), rtol=1e-11, atol=1e-12).y[:, -1]
    found = integrate(
        start(v_x=0.5)[None],
        np.tile(u, (1, 1000, 1)),
        np.tile(noise, (1, 1001, 1)),
        parameters[None],
        STEP_S,
    )[0, -1]
    assert np.abs(found - exact).max() < 1e-7


def test_a_canted_thrust_drives_a_level_vehicle_along_its_heading():
    model, heading_rad, k = NOMINAL.with_term("canted_thrust", ahead=0.02, left=-0.01), 0.9, 0.559
    u = np.zeros((1, 1000, len(COMMAND)))
    at = integrate(
        start(yaw=heading_rad)[None], u, np.zeros((1, 1001, len(NOISE))), model.parameters()[None], STEP_S
    )[0, -1]
    assert at[STATE.index("roll")] == at[STATE.index("pitch")] == 0.0
    speed = (at[STATE.index("v_x")] + 1j * at[STATE.index("v_y")]) * np.exp(-1j * heading_rad)
    assert speed == pytest.approx(GRAVITY_M_S2 * (0.02 - 0.01j) / k * (1.0 - np.exp(-2.0 * k)), abs=1e-9)


def test_members_of_an_ensemble_are_as_if_flown_alone():
    models = [NOMINAL, NOMINAL.with_term("quadratic_drag", c=0.2)]
    rng = np.random.default_rng(1)
    u, noise = rng.uniform(-0.2, 0.2, (2, 200, 6)), rng.normal(0, 0.01, (2, 201, 8))
    q = np.stack([model.parameters() for model in models])
    states = np.stack([start(), start(2.0)])
    both = integrate(states, u, noise, q, STEP_S)
    for j in range(2):
        alone = integrate(states[j : j + 1], u[j : j + 1], noise[j : j + 1], q[j : j + 1], STEP_S)
        assert np.array_equal(both[j], alone[0])


def test_a_landed_vehicle_comes_to_rest_on_its_gear():
    states = flown(NOMINAL, 3.0, start(0.3, v_x=0.4), up=-0.25)
    z = states[:, 2]
    touch = np.flatnonzero(z < 0.08)[0]
    assert z.min() > 0.07
    assert z[touch:].max() < 0.081
    assert np.ptp(z[touch + 60 :]) < 1e-3
    assert np.abs(states[-1, 3:6]).max() < 1e-4
    tilted = flown(NOMINAL, 1.0, states[-1], forward=0.5, up=-0.1)
    assert np.abs(tilted[-1, 3:5]).max() < 1e-3
    assert tilted[-1, STATE.index("pitch")] > 0.2
    away = flown(NOMINAL, 1.0, states[-1], up=0.5)
    assert away[-1, 2] > 0.3


def test_hold_noise_fades_over_the_last_centimetres():
    noise = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)
    for z, share in ((1.0, 1.0), (0.12, 1.0), (0.10, 0.5), (0.08, 0.0)):
        found = rate(NOMINAL, start(z), noise)
        assert [found[n] for n in ("x", "y", "z")] == pytest.approx(share * np.array([0.04, 0.05, 0.06]))
        assert found["pitch"] == pytest.approx(share * 0.02 / 0.1)
        assert found["yaw_rate"] == pytest.approx(share * 0.03 / 0.05)


def test_a_readout_between_nodes_is_a_part_of_a_step():
    """Against an integration with a smaller step that has a node there."""
    rng = np.random.default_rng(2)
    u = np.tile(rng.uniform(-0.3, 0.3, 6), (1, 100, 1))
    noise = np.zeros((1, 101, 8))
    q = NOMINAL.parameters()
    coarse = integrate(start()[None], u, noise, q[None], STEP_S)[0]
    fine = integrate(start()[None], np.repeat(u, 4, 1), np.zeros((1, 401, 8)), q[None], STEP_S / 4)[0]
    node = np.array([10, 50, 99])
    past_s = np.full(3, 0.75 * STEP_S)
    moments = Moments(node, past_s, u[0, node], u[0, node], noise[0, node], np.zeros((3, 3)))
    at, rates, acceleration = read_out(coarse, noise[0], q, moments)
    assert np.abs(at - fine[4 * node + 3]).max() < 1e-8
    assert np.allclose(acceleration, rates[:, 3:6])


def test_parameters_are_those_of_model_and_catalogue():
    q = dict(zip(PARAMETERS, NOMINAL.parameters(), strict=True))
    assert q["vehicle.drag_1_s"] == 0.559
    assert q["tilt_limit.limit"] == pytest.approx(np.pi / 2)
    lagging = NOMINAL.with_term("attitude_lag", tau=0.2).with_term("trim_offset", pitch=0.01)
    changed = dict(zip(PARAMETERS, lagging.parameters(), strict=True))
    assert {n for n in q if q[n] != changed[n]} == {"vehicle.attitude_time_s", "trim_offset.pitch"}
