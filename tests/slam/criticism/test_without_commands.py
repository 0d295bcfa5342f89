"""Flights without commands: instruments against each other, whoever steered."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from slam.criticism import criticise, next_flight
from slam.criticism.finding import ImplausibleSize
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.simulation.healthy.flights import simulate_flight, simulate_readings
from slam.simulation.healthy.handheld_motions import HANDHELD_MOTIONS, handheld_motion
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.criticism.without_commands.unsteered import delayed, flights, found_in


def test_healthy_instruments_agree_whatever_moves_the_vehicle():
    for term, size in (("", {}), ("quadratic_drag", {"c": 0.2}), ("control_latency", {"T": 0.1})):
        found = found_in(term, **size)
        assert found.verdict == "nothing_wrong", found.sentence
        assert "no command log" in found.sentence.lower()


@pytest.mark.parametrize(
    ("term", "parameter", "size"),
    [
        ("gyro_bias", "z", 0.006),
        pytest.param("gyro_scale", "eps", 0.03, marks=pytest.mark.slow),
        ("accel_bias", "z", 0.15),
        pytest.param("flow_scale", "eps", 0.12, marks=pytest.mark.slow),
        ("sonar_lag", "T", 0.12),
    ],
)
def test_an_instrument_that_errs_is_named_with_its_size(term, parameter, size, monkeypatch):
    # The next flight, which is chosen by trying every motion, is not judged here.
    monkeypatch.setattr(next_flight, "MANOEUVRES", list(next_flight.MANOEUVRES)[:2])
    monkeypatch.setattr(next_flight, "HANDHELD_MOTIONS", list(next_flight.HANDHELD_MOTIONS)[:2])
    found = found_in(term, **{parameter: size})
    cause = found.causes[0]
    # Weight is nearly all that an accelerometer feels: a scale of it and a push upwards are alike.
    assert term in cause.alternatives
    known = cause.name == term
    reported, due = cause.parameters[parameter if known else "eps"], size if known else size / 9.8
    assert abs(reported.value - due) < 0.2 * due
    assert reported.low < 1.05 * due
    assert reported.high > 0.95 * due
    assert found.extended.holds(cause.name)
    assert found.covariate.rival == cause.rival
    assert cause.rival in cause.alternatives[1:] or cause.alternatives == (cause.name,)


def test_one_instrument_alone_has_nothing_to_be_held_against():
    bare = [replace(f, imu=None, velocity=None, sonar=None) for f in flights()]
    found = criticise(bare)
    assert found.verdict == "unusable"
    assert "no command log" in found.sentence


def test_readings_that_are_not_numbers_are_left_out():
    broken = flights()
    gyro, accel = broken[0].imu.gyro_rad_s.copy(), broken[0].imu.accel_m_s2.copy()
    gyro[50:60], accel[200] = np.inf, np.nan
    broken[0] = replace(broken[0], imu=replace(broken[0].imu, gyro_rad_s=gyro, accel_m_s2=accel))
    assert criticise(broken).verdict == "nothing_wrong"


def test_nothing_and_something_else_are_among_the_hypotheses():
    healthy = {r.name: r.probability for r in found_in().ranking}
    assert healthy[NOTHING] > 0.5
    assert 0.0 < healthy[SOMETHING_ELSE] < 0.2
    biased = {r.name: r.probability for r in found_in("gyro_bias", z=0.006).ranking}
    assert biased["gyro_bias"] > 0.95
    assert biased[NOTHING] < 0.01
    assert biased[SOMETHING_ELSE] < 0.05
    late = [delayed(f, 0.05) for f in flights()]
    found = criticise(late)
    assert "attitude late by 5" in found.remainder
    assert {r.name: r.probability for r in found.ranking}[SOMETHING_ELSE] > 0.9


@pytest.mark.slow
def test_the_proposed_manoeuvre_distinguishes_a_bias_from_a_scale():
    model = load_model("nominal")
    vehicle = model.with_term("accel_bias", z=0.1)
    few = flights("accel_bias", z=0.1)
    found = criticise(few)
    assert found.verdict == "ambiguous"
    assert set(found.equivalence_set) == {"accel_bias", "accel_scale"}
    # What is off along a body axis turns with it; a share of the weight does not.
    reported = re.search(
        r"(hold it .* tilted by 40 deg to all four sides), (.*): (.*) sigma", found.next_flight
    )
    assert reported is not None, found.next_flight
    assert float(reported[3]) > 1.0
    moved = simulate_readings(
        vehicle, model, handheld_motion(reported[1], 3), False, 5, np.random.default_rng(5)
    )
    again = criticise([*few, moved])
    assert again.causes[0].name == "accel_bias"
    assert again.causes[0].alternatives == ("accel_bias",)
    assert again.next_flight == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDHELD_MOTIONS)
def test_healthy_instruments_agree_when_carried(name):
    model = load_model("nominal")
    moved = [
        simulate_readings(model, model, handheld_motion(name, 2), False, seed, np.random.default_rng(seed))
        for seed in range(3)
    ]
    state = handheld_motion(name).at(np.linspace(0.0, 10.0, 200))
    assert state.w_p_m[:, 2].min() > 0.5
    found = criticise(moved)
    assert found.verdict in ("nothing_wrong", "unusable"), found.sentence
    assert not found.causes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "parameter", "size", "channel", "due"),
    [
        ("gyro_bias", "z", 0.006, "yaw from the gyro", 2.0 * 0.006),
        # Foretold from the begin and the middle of two seconds.
        ("accel_bias", "z", 0.2, "height from the accelerometer", 0.2),
    ],
)
def test_the_gain_is_reported_in_the_units_of_what_is_read(term, parameter, size, channel, due):
    found = criticise(flights(term, **{parameter: size}))
    ahead = {c.channel: c for c in found.causes[0].gain.channels if c.horizon_s == 2.0}
    assert abs(ahead[channel].before - due) < 0.3 * due
    assert ahead[channel].after < 0.5 * ahead[channel].before
    assert found.causes[0].gain.foremost == ahead[channel]
    assert ahead["roll from the gyro"].unit == "rad"
    assert found.to_json()["gain"]["channels"][channel]["after"] == pytest.approx(
        ahead[channel].after, rel=1e-4
    )
    assert f"the error of {channel} 2 s ahead is" in " ".join(found.details)


def test_a_size_that_changes_is_reported_as_left_over():
    model = load_model("nominal")
    plan = stick_for(["hover for 8 s"] * 14)
    steady = simulate_flight(model.with_term("accel_bias", x=0.3, y=0.5), plan, 3, maker=model)
    steady = replace(steady, command=None)
    found = criticise([steady])
    assert found.causes[0].name == "accel_bias"
    assert found.remainder == "", found.remainder
    # The second half leans into a wind that the attitude does not see.
    imu = steady.imu
    pushed = imu.accel_m_s2 + np.outer(imu.stamps_s > 60.0, [0.0, 1.5, 0.0])
    found = criticise([replace(steady, imu=replace(imu, accel_m_s2=pushed))])
    assert "accel_bias.y is 0.4" in found.remainder
    assert "to 2 m/s^2 by segments of 10 s, like an attitude error of 9 deg" in found.remainder
    assert "accel_bias.z" not in found.remainder
    y = found.causes[0].parameters["y"]
    assert y.low < 0.5
    assert y.high > 1.5


@pytest.mark.slow
def test_a_component_that_another_term_explains_as_well_is_in_doubt():
    """A hover shows weight alone: a push upwards is a scale of the accelerometer, one to the left is not."""
    wrong = load_model("nominal").with_term("accel_bias", y=0.5, z=0.3)
    flight = simulate_flight(wrong, stick_for(["hover for 8 s"] * 8), 3, maker=load_model("nominal"))
    doubts = [str(found) for found in criticise([replace(flight, command=None)]).findings]
    assert "accel_bias.z may be accel_scale" in doubts
    assert not any(doubt.startswith(("accel_bias.x", "accel_bias.y")) for doubt in doubts)


@pytest.mark.slow
@pytest.mark.parametrize("eps", [-0.15, 0.15])
def test_a_size_that_is_not_plausible_is_told_and_is_no_cause(eps):
    wrong = [replace(f, imu=replace(f.imu, gyro_rad_s=(1.0 + eps) * f.imu.gyro_rad_s)) for f in flights()]
    found = criticise(wrong)
    assert all(cause.name != "gyro_scale" for cause in found.causes)
    told = [finding for finding in found.findings if isinstance(finding, ImplausibleSize)]
    assert [finding.column for finding in told] == ["gyro_scale.eps"]
    assert told[0].value == pytest.approx(eps, abs=0.02)


def test_what_single_readings_show_is_reported_without_commands():
    spiked = flights()
    ranges = spiked[0].sonar.range_m.copy()
    ranges[[100, 200, 300]] *= 2.0
    spiked[0] = replace(spiked[0], sonar=replace(spiked[0].sonar, range_m=ranges))
    found = criticise(spiked)
    assert [cause.name for cause in found.causes] == ["sonar_spikes"], found.sentence
    assert found.extended.holds("sonar_spikes")
    probability = {rank.name: rank.probability for rank in found.ranking}
    assert probability["sonar_spikes"] > 0.95
    assert probability[NOTHING] < 0.05
