"""Replays of simulated flights: whose model is known, so that what is left over is known too."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slam import simulate
from slam.cli.replay import table
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import unread
from slam.core.streams import AttitudeSeries, Command, Truth, Velocity
from slam.simulation.model import Model
from slam.simulation.recipe import recipe_from
from slam.simulation.replay import replay
from slam.simulation.replay.figure import draw, figure

CALM = {
    "tilt_std_deg": 0, "yaw_rate_std_deg_s": 0, "velocity_std_m_s": 0, "velocity_up_std_m_s": 0,
}  # fmt: skip
HONEST = {
    "imu": {"rate_hz": 100.0, "gyro_noise_density": 0, "accel_noise_density": 0},
    "attitude": {"noise_std_deg": 0},
    "velocity": {"noise_std_m_s": 0},
    "sonar": {"noise_std_m": 0},
}
ROWS = [
    [0, 0, 0, 0, 0], [1000, 0.2, 0, 0, 0.2], [2513, -0.1, 0.15, 0.2, 0], [3500, 0, 0, 0, 0],
    [5007, 0, -0.2, -0.2, -0.3], [6000, 0.15, 0, 0, 0], [8000, 0, 0, 0, 0], [13000, 0, 0, 0, 0],
]  # fmt: skip


def flown(seed=0, **tables):
    mapping = {
        "name": "s",
        "camera": "none",
        "maneuver": {"script": ROWS, "height_m": 1.5, "heading_deg": 40.0},
        "world": {"extent_m": [-50, -50, 50, 50]},
        **tables,
    }
    recipe = recipe_from(mapping, "test")
    return simulate(recipe, seed), recipe.model


@cache
def drawn():
    """A replay and its figure."""
    result = replay(*flown(5))
    return result, figure(result)


def errors(result):
    return {channel.name: channel.rms for channel in result.channels}


def without_truth(flight):
    return replace(flight, truth=None)


EXACT = {"attitude": 1.5e-3, "velocity": 1e-2, "sonar": 8e-3, "imu.gyro": 4e-3, "imu.accel": 4e-2}
"""Error of the initial states from straight-line fits: a third of the instruments' noise or less."""


@pytest.mark.parametrize(
    ("term", "values"),
    [
        (None, {}),
        pytest.param("control_latency", {"T": 0.0871}, marks=pytest.mark.slow),
        ("quadratic_drag", {"c": 0.2}),
        pytest.param("flow_scale", {"eps": 0.2}, marks=pytest.mark.slow),
        pytest.param("flow_derotation", {"kappa": 0.1}, marks=pytest.mark.slow),
        pytest.param("sonar_scale", {"eps": 0.05}, marks=pytest.mark.slow),
        pytest.param("sonar_lag", {"T": 0.1}, marks=pytest.mark.slow),
        pytest.param("sonar_temperature", {"rise": 10.0}, marks=pytest.mark.slow),
        pytest.param("gyro_bias", {"x": 0.02, "z": -0.02}, marks=pytest.mark.slow),
        pytest.param("imu_misalignment", {"x": 0.04, "y": -0.03}, marks=pytest.mark.slow),
        pytest.param("clock_drift", {"ppm": 500.0}, marks=pytest.mark.slow),
        pytest.param("battery_sag", {"loss": 0.2}, marks=pytest.mark.slow),
        pytest.param("steady_wind", {"x": 0.5, "y": 0.2}, marks=pytest.mark.slow),
        pytest.param("floor_slope", {"x": 0.04}, marks=pytest.mark.slow),
    ],
)
def test_a_flight_without_noise_is_its_own_models(term, values):
    """Also with something wrong, as long as the model knows of it: motion, instruments and clocks."""
    terms = {"terms": {term: values}} if term else {}
    flight, model = flown(hold_noise=CALM, **HONEST, **terms)
    result = replay(without_truth(flight), model)
    assert result.started_from == "instruments"
    assert result.rollouts == {0.5: pytest.approx(50, abs=3), 2.0: 11, 10.0: 2}
    for name, rms in errors(result).items():
        limit = next(limit for kind, limit in EXACT.items() if name.startswith(kind))
        assert max(rms.values()) < limit, name
    # A scale of the range is taken up by the beginnings, but for the climbs.
    if term and term not in ("sonar_scale", "sonar_temperature"):
        plain = errors(replay(without_truth(flight), replace(model, terms={})))
        ratio = max(plain[name][2.0] / max(rms[2.0], 1e-9) for name, rms in errors(result).items())
        assert ratio > 2.5


def test_errors_of_a_noisy_flight_are_what_its_noise_makes_and_a_wrong_model_makes_more():
    flight, model = flown(1)
    right = errors(replay(without_truth(flight), model))
    wrong = errors(replay(without_truth(flight), model.with_term("quadratic_drag", c=0.3)))
    assert 0.03 < right["velocity.v_x"][0.5] < right["velocity.v_x"][10.0] < 0.12
    assert 0.005 < right["attitude.pitch"][0.5] < 0.012
    assert wrong["velocity.v_x"][10.0] > 1.5 * right["velocity.v_x"][10.0]
    assert wrong["attitude.pitch"][2.0] == pytest.approx(right["attitude.pitch"][2.0], rel=0.02)


def test_from_the_truth_where_no_speed_was_recorded_and_with_a_yaw_of_its_own_zero():
    flight, model = flown(hold_noise=CALM, **HONEST)
    turned = flight.attitude.roll_pitch_yaw_rad + [0, 0, 2.5]
    attitude = replace(flight.attitude, roll_pitch_yaw_rad=turned)
    bare = replace(flight, velocity=None, imu=None, sonar=None, attitude=attitude)
    result = replay(bare, model)
    assert result.started_from == "truth"
    assert "turned by -143.2 deg" in result.warnings[0]
    found = errors(result)
    assert set(found) == {f"attitude.{n}" for n in ("roll", "pitch", "yaw")} | {
        f"truth.{n}" for n in ("x", "y", "z", "v_x", "v_y", "v_z", "roll", "pitch", "yaw")
    }
    assert found["attitude.yaw"][2.0] < 1e-2
    assert found["truth.x"][10.0] < 0.05


def test_missing_columns_are_left_out_and_missing_height_is_reported():
    flight, model = flown(2)
    half = flight.attitude.roll_pitch_yaw_rad.copy()
    half[:, [0, 2]] = np.nan
    speed = flight.velocity.v_m_s.copy()
    speed[:, 1] = np.nan
    bare = Flight(
        "half",
        attitude=AttitudeSeries(flight.attitude.stamps_s, half),
        velocity=Velocity(flight.velocity.stamps_s, speed),
        command=flight.command,
    )
    result = replay(bare, model)
    assert [channel.name for channel in result.channels] == ["attitude.pitch", "velocity.v_x"]
    assert any("no height" in warning for warning in result.warnings)
    at_rest = replay(replace(bare, velocity=None), model)
    assert any("begin at rest" in warning for warning in at_rest.warnings)


def test_roll_outs_that_cannot_begin_in_a_gap_are_counted():
    flight, model = flown(3)
    keep = (flight.velocity.stamps_s < 4) | (flight.velocity.stamps_s > 7)
    velocity = Velocity(flight.velocity.stamps_s[keep], flight.velocity.v_m_s[keep])
    result = replay(without_truth(replace(flight, velocity=velocity)), model)
    assert 8 <= result.skipped[0.5] <= 13
    assert result.rollouts[0.5] + result.skipped[0.5] == pytest.approx(50, abs=3)


def test_the_full_stick_is_the_models_and_another_is_reported():
    flight, model = flown(hold_noise=CALM, **HONEST)
    other = replace(flight, command=Command(flight.command.stamps_s, flight.command.stick, 0.2094))
    result = replay(without_truth(other), model)
    assert result.max_tilt_rad == model.vehicle.max_tilt_rad == 0.5236
    assert errors(result)["attitude.pitch"][2.0] < 1e-3
    assert any("0.2094" in warning for warning in result.warnings)
    plain = replay(without_truth(flight), model)
    assert not any("full stick" in warning for warning in plain.warnings)


def test_the_beginnings_do_not_depend_on_the_model():
    flight, model = flown(4)
    a = replay(without_truth(flight), model)
    b = replay(without_truth(flight), model.with_term("active_braking", k_b=1.0))
    assert (a.rollouts, a.skipped, a.begin_s) == (b.rollouts, b.skipped, b.begin_s)


def test_a_sample_beside_a_change_of_the_stick_is_not_held_against_the_model():
    flight, model = flown(hold_noise=CALM, **HONEST)
    imu, changes = flight.imu, np.array([1.0, 2.513, 3.5, 5.007, 6.0, 8.0])
    near = np.abs(imu.stamps_s[:, None] - changes).min(1) < 0.001
    stamps = np.sort(np.concatenate([imu.stamps_s[~near], changes - 0.0005]))
    gyro = np.zeros((len(stamps), 3))
    for axis in range(3):
        gyro[:, axis] = np.interp(stamps, imu.stamps_s, imu.gyro_rad_s[:, axis])
    gyro[np.abs(stamps[:, None] - changes).min(1) < 0.001] = 5.0
    accel = np.column_stack([np.interp(stamps, imu.stamps_s, column) for column in imu.accel_m_s2.T])
    spoilt = replace(flight, imu=replace(imu, stamps_s=stamps, gyro_rad_s=gyro, accel_m_s2=accel), truth=None)
    assert errors(replay(spoilt, model))["imu.gyro_x"][2.0] < 0.06


def test_the_picture_is_a_picture():
    png = draw(replace(drawn()[0], flight="a $strange_name"))
    assert png.startswith(b"\x89PNG")


def test_picture_and_table_show_the_same_figures_in_the_same_units():
    result, shown = drawn()
    *panels, braking = [axes.get_title(loc="left") for axes in shown.axes]
    rows = table(result).rows
    at = list(result.rollouts).index(result.shown_s) + 1
    assert braking.startswith("the longest push")
    assert panels == [f"{row[0]}, off by {row[at]}" for row in rows]
    assert any(row[0].endswith("[deg]") for row in rows)
    assert not any("rad" in row[0] for row in rows)
    assert f"RMS over {result.shown_s:g} s" in shown.get_suptitle()


def test_the_picture_enlarges_the_longest_push_and_leaves_out_empty_channels():
    result, shown = drawn()
    begin_s, end_s = max(result.pushes_s, key=lambda push: push[1] - push[0])
    assert (begin_s, end_s) == pytest.approx((5.007, 8.0))
    shown_s = shown.axes[-1].get_xlim()
    assert shown_s[0] < begin_s
    assert shown_s[1] > end_s + 2
    empty = replace(result.channels[0], measured=np.full_like(result.channels[0].measured, np.nan))
    fewer = figure(replace(result, channels=(empty, *result.channels[1:])))
    assert len(fewer.axes) == len(shown.axes) - 1


STAMPS = np.arange(0, 5, 0.05)
NO_ROWS = unread("data.csv has no rows", "treated as not recorded").named("command0")
SOME = Command(STAMPS, np.zeros((100, 4)))
STILL = Truth(STAMPS, np.tile(np.eye(4), (100, 1, 1)))


@pytest.mark.parametrize(
    ("flight", "said"),
    [
        (Flight("f", truth=STILL), "no commands"),
        (Flight("f", truth=STILL, messages=(NO_ROWS,)), "command0: data.csv has no rows, so"),
        (Flight("f", command=replace(SOME, stamps_s=STAMPS[:1], stick=SOME.stick[:1])), "command0 has 1 row"),
        (Flight("f", command=SOME), "nothing but commands"),
        (
            Flight("f", command=SOME, truth=replace(STILL, stamps_s=STAMPS + 100)),
            "another clock, 95 s away .* write the stamps",
        ),
        (
            Flight("f", command=SOME, attitude=AttitudeSeries(STAMPS[:2], np.zeros((2, 3)))),
            "commands and readings share 0.05 s",
        ),
    ],
)
def test_a_flight_that_cannot_be_replayed_is_refused_in_one_line(flight, said):
    with pytest.raises(InputError, match=said) as caught:
        replay(flight, Model())
    assert "\n" not in str(caught.value)


def test_a_heading_that_passes_half_a_turn_is_the_same_heading():
    """Written between -pi and pi; measured and simulated differ by less than a turn, for plots."""
    flight, model = flown(3)
    angles = flight.attitude.roll_pitch_yaw_rad.copy()
    middle = np.median(angles[:, 2])
    angles[:, 2] = np.angle(np.exp(1j * (angles[:, 2] - middle + np.pi)))
    assert np.abs(np.diff(angles[:, 2])).max() > 6
    wrapped = replace(without_truth(flight), attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))
    yaw = next(c for c in replay(wrapped, model).channels if c.name == "attitude.yaw")
    assert np.abs(np.diff(yaw.measured)).max() < 1
    for simulated in (yaw.simulated, yaw.restarted):
        assert np.nanmax(np.abs(simulated - yaw.measured)) < 1
