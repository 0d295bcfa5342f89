"""Flights without commands: instruments against each other, whoever steered."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slam.criticism import criticise, next_flight
from slam.criticism.finding import ImplausibleSize
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.criticism.without_commands.explanation import search_linear
from slam.criticism.without_commands.likelihood import PATTERNS, likelihood_of
from slam.criticism.without_commands.sensor_comparison import SensorComparison
from slam.data_quality.inertial_comparison import NODE_S
from slam.data_quality.lag import Lag
from slam.data_quality.whitened_rows import inertial_residuals, lags_of
from slam.simulation.healthy.flights import healthy_case, simulate_flight, simulate_readings
from slam.simulation.healthy.handheld_motions import HANDHELD_MOTIONS, handheld_motion
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.criticism.camera.camera_flight import camera_flight

PLANS = (
    ["climb and descend by 0.6 m", "three speeds forward: 0.1, 0.2, 0.4", "yaw steps at 0.3, 0.6 and 1"],
    ["brisk climb steps at full stick", "three speeds to the side: 0.1, 0.2, 0.4", "hover for 8 s"],
    ["up to 2 m, hover, and back", "reversing forward at 0.2", "yaw steps at 0.3, 0.6 and 1"],
)  # fmt: skip


def flights(term="", **size):
    return list(_flights(term, **size))


@cache
def _flights(term, **size):
    model = load_model("nominal")
    vehicle = model.with_term(term, **size) if term else model
    return [
        replace(simulate_flight(vehicle, stick_for(plan), 40 + k, maker=model), command=None)
        for k, plan in enumerate(PLANS)
    ]


@cache
def found_in(term="", **size):
    """What is found in the three flights."""
    return criticise(flights(term, **size))


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


@pytest.mark.parametrize("seed", [9502, 9538])
def test_a_rate_that_jumps_between_two_samples_is_no_scale_of_the_gyro(seed):
    flight = replace(healthy_case(load_model("nominal"), seed, 1, 30.0)[0], command=None)
    assert score([inertial_residuals(flight)], "gyro_scale").z < 3.2


def score(rows, name):
    """The score test of one effect alone."""
    expansion = expansion_of(rows)
    return expansion.score_tests([], [e for e in expansion.effects if e.name == name])[0]


def expansion_of(rows):
    return likelihood_of(rows, filter_parameters_of(load_model("nominal"))).last


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


def delayed(flight, by_s):
    """With an attitude that comes late, which no term is."""
    return replace(flight, attitude=replace(flight.attitude, stamps_s=flight.attitude.stamps_s + by_s))


def compared(every):
    """Return the rows of some flights, linear about the lags of their streams."""
    lags = lags_of(every)
    return [inertial_residuals(flight, lags) for flight in every]


@pytest.mark.parametrize("time_s", [0.1, -0.08])
def test_an_attitude_that_lags_is_no_error_of_the_speed(time_s):
    """The attitude turns the accelerometer into the world: where it lags, the integrated speed is wrong.
    ``time_s``: a delay, or the negative time constant of a filter."""

    def lagging(flight):
        if time_s > 0.0:
            return delayed(flight, time_s)
        stamps_s, angles = flight.attitude.stamps_s, flight.attitude.roll_pitch_yaw_rad
        angles = Lag(smoothing_s=-time_s).of(stamps_s, np.unwrap(angles, axis=0))
        return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles))

    parameters = filter_parameters_of(load_model("nominal"))
    rows = compared([lagging(f) for f in flights()])
    assert all("attitude.delay_s" in r.traces for every in rows for r in every if r.kind == "velocity")
    found = search_linear(likelihood_of(rows, parameters))
    sizes = found.last.sizes(found.chosen)
    assert not any(effect.is_term for effect in found.chosen), sizes
    assert abs(sizes["attitude.delay_s"] - abs(time_s)) < 0.015
    assert abs(max(sizes.get("attitude smoothed", 0.0), 0.0) ** 0.5 - max(-time_s, 0.0)) < 0.02


@pytest.mark.parametrize("late_s", [0.06, 0.16, 0.3])
def test_a_late_speed_is_told_with_its_delay_however_long_it_is(late_s):
    """Far from the truth the noise of the rows has the delay in it: rows are linear about the likeliest."""

    def late(flight):
        velocity = flight.velocity
        return replace(flight, velocity=replace(velocity, stamps_s=velocity.stamps_s + late_s))

    expansion = expansion_of(compared([late(flight) for flight in flights()]))
    found = next(s for s in expansion.score_tests([], expansion.effects) if s.effect.name == "velocity late")
    size = expansion.sizes([found.effect])["velocity.delay_s"]
    print(f"late by {late_s} s: found {size:.3f} s, z {found.z:.1f}")
    assert abs(size - late_s) < 0.03
    assert found.z > 5.0


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


def test_a_reading_a_little_late_of_an_even_clock_does_not_show_what_runs_away():
    """Of an accelerometer that is off, what is integrated twice is hundreds of metres after a minute."""
    model = load_model("nominal")
    plan = ["climb and descend by 0.6 m", "hover for 8 s"] * 5
    flight = simulate_flight(model.with_term("accel_bias", z=0.3), stick_for(plan), 3, maker=model)
    (height,) = (r.averages for r in inertial_residuals(flight) if r.kind == "height")
    column = height.table[:, height.column("accel_bias.z")]
    curved = (column[2:] - 2.0 * column[1:-1] + column[:-2]) / NODE_S**2
    np.testing.assert_allclose(curved, -1.0, atol=0.1)


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


def seen(terms):
    """Three flights of ten seconds with pictures, of which nobody knows the sticks."""
    return [replace(camera_flight(terms, seed), name=f"seen {seed}", command=None) for seed in (5, 6, 7)]


@pytest.mark.slow
def test_healthy_pictures_agree_with_the_other_instruments():
    found = criticise(seen({}))
    assert found.verdict == "nothing_wrong", found.sentence
    assert "focal_length" in found.detectable


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "parameter", "size"),
    [
        pytest.param("focal_length", "eps", 0.06, marks=pytest.mark.slow),
        ("rolling_shutter", "readout", 0.03),
    ],
)
def test_pictures_are_held_against_the_other_instruments(term, parameter, size):
    found = criticise(seen({term: {parameter: size}}))
    cause = found.causes[0]
    assert cause.name == term, found.sentence
    reported = cause.parameters[parameter]
    assert reported.low < size < reported.high
    assert abs(reported.value - size) < 0.25 * size
    missed = next(c for c in cause.gain.channels if c.unit == "px")
    assert missed.after < missed.before


@pytest.mark.slow
def test_what_was_found_counts_once_however_often_pictures_are_made_linear_about_it():
    found = SensorComparison.of(seen({}), load_model("nominal"))
    plain = expansion_of(found.rows({}))
    # No filter parameters hold a pattern, or a variance below 0: rows about them are rows about none.
    shape = PATTERNS[0]
    about = expansion_of(found.rows({shape: 2.0, "motion_blur.exposure": -1e-4}))
    np.testing.assert_allclose(about.fisher.score, plain.fisher.score)
    # About a size that the parameters do hold, what is off is the same, whatever has been taken out.
    near = expansion_of(found.rows({"focal_length.eps": 0.01}))
    whole = [e for e in plain.effects if e.name in ("focal_length", "sonar_scale", "camera_tilt")]
    first, second = plain.sizes(whole), near.sizes(whole)
    assert abs(second["focal_length.eps"] - first["focal_length.eps"]) < 0.002


def test_pictures_that_nothing_agrees_with_are_reported_and_name_no_cause():
    flight = replace(camera_flight({}, 5, rate_hz=2.0), command=None)
    wild = replace(flight.velocity, v_m_s=100.0 * flight.velocity.v_m_s)
    found = criticise([replace(flight, velocity=wild)])
    assert (found.verdict, found.causes) == ("unknown", ())
    assert "pictures disagree" in found.remainder
    # A height alone makes no path.
    assert criticise([replace(flight, imu=None, attitude=None, velocity=None)]).verdict == "unusable"


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
