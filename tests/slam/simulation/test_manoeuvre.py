import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.core.errors import InputError
from slam.simulation.manoeuvre import MAX_YAW_RATE_RAD_S, Manoeuvre, plan

EXTENT = (-5.0, -5.0, 5.0, 5.0)
MARKS = {"A": (0.0, 0.0), "B": (3.0, 0.0), "C": (3.0, 2.0)}
points = st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(0.5, 3))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(points, min_size=1, max_size=6),
    st.floats(0.1, 3),
    st.floats(0.3, 4),
    st.sampled_from(["fixed", "along_path"]),
    st.sampled_from([0.0, 0.7]),
)
def test_every_path_is_smooth_and_within_its_limits(way_points, cruise, limit, heading, rest_s):
    maneuver = Manoeuvre(
        tuple(way_points), cruise_m_s=cruise, acceleration_m_s2=limit, heading=heading, rest_s=rest_s
    )
    path = plan(maneuver, {}, EXTENT)
    position, velocity, acceleration, jerk = path.derivatives
    t = np.linspace(0, path.duration_s, 1501)
    assert np.linalg.norm(velocity(t)[:, :3], axis=1).max() <= cruise * (1 + 1e-6)
    assert np.linalg.norm(acceleration(t)[:, :3], axis=1).max() <= limit * (1 + 1e-6)
    assert np.abs(velocity(t)[:, 3]).max() <= MAX_YAW_RATE_RAD_S * (1 + 1e-6)
    joints = position.x[1:-1]
    for derivative in path.derivatives:
        size = 1 + np.abs(derivative(t)).max()
        assert np.abs(derivative(joints - 1e-9) - derivative(joints + 1e-9)).max(initial=0) < 1e-4 * size
    ends = np.array([0.0, path.duration_s])
    assert np.allclose(position(ends)[:, :3], [way_points[0], way_points[-1]])
    assert np.allclose([velocity(ends), acceleration(ends), jerk(ends)], 0, atol=1e-6)


def test_a_corner_is_cut_by_what_the_smooth_step_says():
    # The quintic step integrates to 5/64 over its first half: the corner is missed by |dv| T 5/64.
    maneuver = Manoeuvre(("A", "B", "C"), cruise_m_s=0.5, acceleration_m_s2=1.0)
    path = plan(maneuver, MARKS, EXTENT)
    t = np.linspace(0, path.duration_s, 20001)
    nearest = np.linalg.norm(path.derivatives[0](t)[:, :2] - [3.0, 0.0], axis=1).min()
    change = 0.5 * math.sqrt(2)
    corner_s = 15 / 8 * change / 1.0
    assert nearest == pytest.approx(change * corner_s * 5 / 64, rel=1e-4)


def test_the_time_is_the_length_over_the_speed_and_one_start():
    path = plan(Manoeuvre(("A", "B"), cruise_m_s=0.5, rest_s=2.0), MARKS, EXTENT)
    assert path.duration_s == pytest.approx(3.0 / 0.5 + 15 / 8 * 0.5 + 4.0)


def test_laps_fly_the_same_way_again_without_a_stop():
    once = plan(Manoeuvre(("A", "B", "C", "A")), MARKS, EXTENT)
    thrice = plan(Manoeuvre(("A", "B", "C", "A"), laps=3), MARKS, EXTENT)
    ground = 3 + 2 + math.hypot(3, 2)
    lap_s = ground / 0.5
    assert thrice.duration_s - once.duration_s == pytest.approx(2 * lap_s, abs=1.0)
    t = np.linspace(0.3 * lap_s, 0.9 * lap_s, 50)
    for lap in (1, 2):
        assert np.allclose(thrice.derivatives[0](t + lap * lap_s), thrice.derivatives[0](t), atol=1e-9)
    speed = np.linalg.norm(thrice.derivatives[1](np.linspace(3, thrice.duration_s - 3, 2000))[:, :3], axis=1)
    assert speed.min() > 0.1


def test_the_heading_along_the_path_is_where_the_vehicle_goes():
    path = plan(Manoeuvre(("A", "B", "C", "A"), heading="along_path", cruise_m_s=0.3), MARKS, EXTENT)
    t = np.linspace(0, path.duration_s, 3000)
    velocity = path.derivatives[1](t)
    straight = (np.linalg.norm(velocity[:, :2], axis=1) > 0.299) & (np.abs(velocity[:, 3]) < 1e-9)
    assert straight.mean() > 0.5
    yaw, course = (
        path.derivatives[0](t)[straight, 3],
        np.arctan2(velocity[straight, 1], velocity[straight, 0]),
    )
    assert np.abs(np.angle(np.exp(1j * (yaw - course)))).max() < 1e-9
    assert np.ptp(path.derivatives[0](t)[:, 3]) < 2 * np.pi


@pytest.mark.parametrize(
    ("maneuver", "said"),
    [
        (Manoeuvre(("A", "Q")), "no landmark 'Q'"),
        (Manoeuvre(("A", (9.0, 0.0))), r"way_points\[1\].*leaves the floor"),
        (Manoeuvre(("A", (1.0, 0.0, -0.5))), r"way_points\[1\].*ground"),
        (Manoeuvre(("A", (1.0, 0.0, 0.05))), r"way_points\[1\].*ground"),
        (Manoeuvre(("A", (math.nan, 0.0, 1.0))), "leaves the floor"),
        (Manoeuvre(("A", (1.0, 0.0, math.nan))), "ground"),
        (Manoeuvre(("A", "B"), laps=2), "end where they begin"),
        (Manoeuvre(("A", "B", "A"), laps=1000, cruise_m_s=0.01), "6 h"),
    ],
)
def test_a_path_that_cannot_be_flown_is_refused_in_one_line(maneuver, said):
    with pytest.raises(InputError, match=said) as caught:
        plan(maneuver, MARKS, EXTENT)
    assert "\n" not in str(caught.value)
