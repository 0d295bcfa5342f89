"""Colour competes with causes: taken where noise has it, and not for an effect that colours innovations."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.record import record_of
from slam.criticism.search.expansion import expand
from slam.criticism.search.fitting import fit_nuisances, with_ar1_noise
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLANS = (
    ["tilts of 15 deg to all four sides", "yaw on the spot while climbing"],
    ["reversing forward at 0.2", "climb and descend by 0.6 m", "short pulses of 0.2 s forward at half stick"],
)


def slow():
    return at_lower_rates(load_model("nominal"))


def measured(vehicle, attitude=lambda angles, t: angles):
    """Records of two flights of a vehicle, the model, and the healthy parameters."""
    records = []
    for k, plan in enumerate(PLANS):
        flight = simulate_flight(vehicle, stick_for(plan), 50 + k, maker=slow())
        read = flight.attitude
        angles = attitude(read.roll_pitch_yaw_rad, read.stamps_s)
        records.append(record_of(replace(flight, attitude=replace(read, roll_pitch_yaw_rad=angles))))
    model = filter_parameters_of(slow())
    return records, model, fit_nuisances(records, model)


def asked(vehicle, most_nats=10.0, attitude=lambda angles, t: angles):
    """Return the parameters with AR(1) noise that the healthy ones lead to, or None."""
    records, model, parameters = measured(vehicle, attitude)
    passes = [whole(record, parameters) for record in records]
    about = SimpleNamespace(model=model, parameters=parameters, fisher=SimpleNamespace(passes=passes))
    return with_ar1_noise(about, (), most_nats)


@pytest.mark.slow
def test_only_correlated_noise_is_reported():
    vehicle = slow()
    vehicle = replace(
        vehicle,
        velocity=replace(vehicle.velocity, noise_correlation=0.4),
        sonar=replace(vehicle.sonar, noise_correlation=0.5),
    )
    found = asked(vehicle)
    assert found is not None
    assert np.array_equal(found.noise_correlation > 0, [False, False, False, True, True])
    assert found.noise_correlation[3:] == pytest.approx([0.4, 0.5], abs=0.1)
    # What explains more than the colour of so few readings is believed before it.
    assert asked(vehicle, most_nats=3000.0) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("control_latency", {"T": 0.04}),
        ("gusts", {"sigma": 0.3, "tau": 1.0}),
        ("timestamp_jitter", {"sigma": 0.006}),
        ("quadratic_drag", {"c": 0.2}),
    ],
)
def test_an_effect_is_no_ar1_noise_even_where_nothing_else_explains_it(name, values):
    assert asked(slow().with_term(name, **values), most_nats=0.0) is None


@pytest.mark.slow
def test_a_late_sonar_explains_more_than_ar1_noise():
    """One channel by itself: here only the comparison tells them apart."""
    records, model, parameters = measured(slow().with_term("sonar_lag", T=0.1))
    expansion = expand(records, model, parameters)
    late = expansion.score_tests([], expansion.effects)[0]
    assert late.effect.name == "sonar_lag"
    assert with_ar1_noise(expansion, (), late.nats) is None


def test_one_drifting_axis_is_no_ar1_noise_of_the_instrument():
    def wandering(angles, t):
        off = 0.01 * np.sin(2 * np.pi * t / 3.0)
        return angles + off[:, None] * [0.0, 0.0, 1.0]

    assert asked(slow(), most_nats=0.0, attitude=wandering) is None
