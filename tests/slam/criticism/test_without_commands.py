"""Flights without commands: instruments against each other, whoever steered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism import criticise
from slam.criticism.healthy import flown
from slam.criticism.manoeuvres import stick_for
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE
from slam.simulation.model import load_model

PLANS = (
    ["climb and descend by 0.6 m", "three speeds forward: 0.1, 0.2, 0.4", "yaw steps at 0.3, 0.6 and 1"],
    ["brisk climb steps at full stick", "three speeds to the side: 0.1, 0.2, 0.4", "hover for 8 s"],
    ["up to 2 m, hover, and back", "reversing forward at 0.2", "yaw steps at 0.3, 0.6 and 1"],
)  # fmt: skip


def flights(term="", **size):
    model = load_model("nominal")
    vehicle = model.with_term(term, **size) if term else model
    return [
        replace(flown(vehicle, stick_for(plan), 40 + k, told=model), command=None)
        for k, plan in enumerate(PLANS)
    ]


def test_healthy_instruments_agree_whatever_moves_the_vehicle():
    for term, size in (("", {}), ("quadratic_drag", {"c": 0.2}), ("control_latency", {"T": 0.1})):
        found = criticise(flights(term, **size))
        assert found.verdict == "nothing_wrong", found.sentence
        assert "no command log" in found.sentence.lower()


@pytest.mark.parametrize(
    ("term", "parameter", "size"),
    [
        ("gyro_bias", "z", 0.006),
        ("gyro_scale", "eps", 0.03),
        ("accel_bias", "z", 0.15),
        ("flow_scale", "eps", 0.12),
        ("sonar_lag", "T", 0.12),
    ],
)
def test_an_instrument_that_errs_is_named_with_its_size(term, parameter, size):
    found = criticise(flights(term, **{parameter: size}))
    cause = found.causes[0]
    # Weight is nearly all that an accelerometer feels: a scale of it and a push upwards are alike.
    assert term in cause.alternatives
    known = cause.name == term
    told, due = cause.parameters[parameter if known else "eps"], size if known else size / 9.8
    assert abs(told.value - due) < 0.2 * due
    assert told.low < 1.05 * due
    assert told.high > 0.95 * due
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
    healthy = {r.name: r.probability for r in criticise(flights()).ranking}
    assert healthy[NOTHING] > 0.5
    assert 0.0 < healthy[SOMETHING_ELSE] < 0.2
    biased = {r.name: r.probability for r in criticise(flights("gyro_bias", z=0.006)).ranking}
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
