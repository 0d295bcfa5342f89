import numpy as np
import pytest

from slam.simulation.dynamics import STEP_S
from slam.simulation.manoeuvre import Manoeuvre, plan
from slam.simulation.model import Model
from slam.simulation.motion import at_rest, draw_model_noise, no_noise, simulate_motion, step_count
from slam.simulation.pilot import TICK_S, fly

EXTENT = (-5.0, -5.0, 5.0, 5.0)
SQUARE = Manoeuvre(((0.0, 0.0), (2.0, 0.0), (2.0, 2.0, 1.3), (0.0, 2.0), (0.0, 0.0)), heading="along_path")


def flown(maneuver=SQUARE, model=Model(), seed=None):
    path = plan(maneuver, {}, EXTENT)
    steps = step_count(path.duration_s)
    rngs = np.random.default_rng((seed or 0, 1)), np.random.default_rng((seed or 0, 2))
    return path, fly(path, model, no_noise(steps) if seed is None else draw_model_noise(model, steps, rngs))


def off(path, motion):
    t = np.minimum(np.arange(len(motion.states)) * STEP_S, path.duration_s)
    return motion.states[:, [0, 1, 2, 8]] - path.derivatives[0](t)


@pytest.mark.parametrize("heading", ["fixed", "along_path"])
def test_without_noise_the_path_is_followed_to_millimetres(heading):
    maneuver = Manoeuvre(SQUARE.way_points, heading=heading, heading_deg=30.0, rest_s=1.0)
    error = np.abs(off(*flown(maneuver))).max(0)
    assert error[:3].max() < 3e-3
    assert error[3] < np.radians(0.1)


@pytest.mark.parametrize("seed", range(3))
def test_with_hold_noise_it_is_followed_to_centimetres(seed):
    error = off(*flown(seed=seed))
    spread = error.std(0)
    assert np.all((spread[:2] > 0.005) & (spread[:2] < 0.03))
    assert 0.001 < spread[2] < 0.01
    assert np.abs(error[:, :3]).max() < 0.1


@pytest.mark.parametrize(
    ("term", "values"),
    [
        ("control_latency", {"T": 0.1}),
        ("steady_wind", {"x": 0.6, "y": -0.4}),
        ("quadratic_drag", {"c": 0.3}),
        ("attitude_lag", {"tau": 0.2}),
        ("trim_offset", {"roll": 0.03}),
    ],
)
def test_a_vehicle_with_something_wrong_still_gets_there(term, values):
    path, motion = flown(model=Model().with_term(term, **values))
    assert np.abs(off(path, motion)[:, :3]).max() < 0.2


def test_the_stick_that_was_logged_flies_the_same_flight_again():
    """The pilot's motion is one that the vehicle makes of the pilot's commands alone."""
    for model in (Model(), Model().with_term("control_latency", T=0.0731)):
        _, motion = flown(model=model, seed=4)
        again = simulate_motion(motion.stick, model, motion.states[0], motion.noise)
        assert np.abs(again.states - motion.states).max() < 1e-8


def test_commands_are_on_time_and_within_the_stick():
    _, motion = flown(Manoeuvre(((0.0, 0.0), (4.0, 0.0, 3.0)), cruise_m_s=5.0, acceleration_m_s2=5.0))
    assert np.allclose(np.diff(motion.stick.stamps_s), TICK_S)
    assert 20 <= 1 / TICK_S <= 50
    assert np.abs(motion.stick.values).max() <= 1.0
    assert np.degrees(np.abs(motion.states[:, 6:8])).max() < 25


def test_a_flight_starts_at_rest_in_the_air():
    _, motion = flown(seed=1)
    assert np.array_equal(motion.states[0], at_rest(0.0, 0.0, 0.8, 0.0))
