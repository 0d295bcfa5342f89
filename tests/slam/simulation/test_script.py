"""Scripts of timed commands: files, the shipped ones, and flights that leave the floor or hit it."""

from dataclasses import replace

import numpy as np
import pytest

from slam import simulate
from slam.core.errors import InputError
from slam.simulation.manoeuvre import Manoeuvre
from slam.simulation.model import load_model
from slam.simulation.recipe import load_recipe, recipe_from
from slam.simulation.recording import fly_recipe
from slam.simulation.script import read_script, stick_from


def recipe(rows, **maneuver):
    return recipe_from(
        {
            "name": "s",
            "camera": "none",
            "maneuver": {"script": rows, **maneuver},
            "world": {"extent_m": [-3, -3, 3, 3]},
        },
        "s.toml",
    )


def test_a_file_and_its_rows_are_the_same_script(tmp_path):
    file = tmp_path / "s.csv"
    file.write_text("# forward, then left\nmilliseconds = 0\n")
    file.write_text("# forward, then left\n0, 0.2,0,0,0\n\n1500,0,0.1,0,0  # left\n 2000 , 0,0,0,0\n")
    assert read_script(file) == ((0, 0.2, 0, 0, 0), (1500, 0, 0.1, 0, 0), (2000, 0, 0, 0, 0))
    stick = stick_from(Manoeuvre(script=str(file), scale=0.5, rest_s=1.0))
    assert stick.stamps_s.tolist() == [1.0, 2.5, 3.0]
    assert stick.values.tolist() == [[0.1, 0, 0, 0], [0, 0.05, 0, 0], [0, 0, 0, 0]]
    assert stick.duration_s == 4.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"0,0,0,0,0\n1000,0,0,0\n", "line 2: '1000,0,0,0': write milliseconds"),
        (b"0,0,0,0,0\n1000,a,0,0,0\n", "line 2"),
        (b"\xff\xfe\x00", "not a text file"),
    ],
)
def test_a_file_that_is_no_script_is_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "s.csv").write_bytes(text)
    with pytest.raises(InputError, match=said) as caught:
        read_script(tmp_path / "s.csv")
    assert "s.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_not_a_number_is_no_command():
    with pytest.raises(InputError, match="finite"):
        stick_from(Manoeuvre(script=((0.0, float("nan"), 0, 0, 0), (9.0, 0, 0, 0, 0))))


@pytest.mark.parametrize(
    ("rows", "maneuver", "said"),
    [
        (
            [[0, 0.3, 0, 0, 0], [9000, 0, 0, 0, 0]],
            {},
            r"leaves the floor after \d\.\d s at \(3\.0, -?0\.\d\)",
        ),
        ([[0, 0, 0, -0.5, 0], [9000, 0, 0, 0, 0]], {}, r"hits the floor after 1\.\d s .*may_land"),
        ([[0, 0, 0, 1, 0], [120000, 0, 0, 0, 0]], {}, "climbs beyond 100 m|leaves the floor"),
        ([[0, 0, 0, 0, 0], [9000, 0, 0, 0, 0]], {"start_m": [5, 0]}, r"leaves the floor after 0\.0 s"),
    ],
)
def test_a_flight_that_cannot_end_well_is_refused_in_one_line(rows, maneuver, said):
    with pytest.raises(InputError, match=said) as caught:
        simulate(recipe(rows, **maneuver), 0)
    assert "\n" not in str(caught.value)


def test_a_script_may_land_where_it_says_so():
    flight = simulate(recipe([[0, 0, 0, -0.5, 0], [4000, 0, 0, 0, 0]], may_land=True), 0)
    z = flight.truth.w_T_b[:, 2, 3]
    assert z[-1] == pytest.approx(0.08, abs=1e-3)
    assert np.isnan(flight.sonar.range_m[-1])


def test_a_flight_without_a_camera_has_all_the_rest():
    flight = simulate("hover", 0)
    assert flight.camera is None
    assert flight.frames is None
    for name in ("imu", "sonar", "attitude", "velocity", "command", "battery", "truth"):
        assert len(getattr(flight, name).stamps_s) > 100


SHIPPED = ["hover", *(f"pulses_{k:03}" for k in (5, 10, 15, 20, 25)), "horizontal_square", "vertical_square"]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in ("pulses_025", "vertical_square") else pytest.mark.slow)
        for name in SHIPPED
    ],
)
def test_a_shipped_script_is_flown_with_either_model(name):
    for model in ("nominal", "paper"):
        motion = fly_recipe(load_recipe(name, model), 3)
        assert np.isfinite(motion.states).all()


def test_pulses_are_the_papers():
    stick = stick_from(load_recipe("pulses_015").maneuver)
    ends = np.append(stick.stamps_s[1:], stick.duration_s)
    out = np.abs(stick.values[:, 0]) > 0
    assert np.round((ends - stick.stamps_s)[out], 9).tolist() == [0.1, 0.1, 1, 1, 2, 2, 3, 3, 5, 5]
    assert stick.values[out, 0].tolist() == [0.15, -0.15] * 5
    assert (ends - stick.stamps_s)[~out][:-1].min() >= 2


@pytest.mark.parametrize(("name", "axes"), [("horizontal_square", (0, 1)), ("vertical_square", (0, 2))])
def test_squares_come_back_to_where_they_began(name, axes):
    calm = load_model("nominal")
    calm = replace(
        calm,
        hold_noise=replace(
            calm.hold_noise, tilt_std_deg=0, yaw_rate_std_deg_s=0, velocity_std_m_s=0, velocity_up_std_m_s=0
        ),
    )
    motion = fly_recipe(replace(load_recipe(name), model=calm), 0)
    place = motion.states[:, :3] - motion.states[0, :3]
    assert np.linalg.norm(place[-1]) < 0.3
    sides = place[:, axes].max(0) - place[:, axes].min(0)
    assert np.all((sides > 0.6) & (sides < 2.2))
