"""Coloured noise in the filter: white innovations, a likelihood that peaks at the truth, exact tangents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of, slot
from slam.criticism.kalman.innovations import Run, whole
from slam.criticism.kalman.kernel_inputs import Perturbation, ar1_states, samples_between
from slam.criticism.kalman.noise import WHITE
from slam.criticism.kalman.readings import INSTRUMENTS, SONAR
from slam.criticism.kalman.record import record_of
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.fitting import lag_one_correlation
from slam.criticism.search.information import SEGMENT_S
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

PLAN = ["tilts of 15 deg to all four sides", "reversing forward at 0.2", "climb and descend by 0.6 m"]
COLOUR = np.array([0.5, 0.3, 0.6, 0.45, 0.4])


def of_colour(colour):
    """The nominal vehicle, at lower rates, whose instruments' noise has these correlations."""
    nominal = load_model("nominal")
    gyro, accel, attitude, velocity, sonar = (float(c) for c in colour)
    return replace(
        nominal,
        imu=replace(nominal.imu, rate_hz=100.0, gyro_noise_correlation=gyro, accel_noise_correlation=accel),
        attitude=replace(nominal.attitude, rate_hz=50.0, noise_correlation=attitude),
        velocity=replace(nominal.velocity, noise_correlation=velocity),
        sonar=replace(nominal.sonar, noise_correlation=sonar),
    )


def flight(seed, colour=COLOUR):
    vehicle = of_colour(colour)
    return simulate_flight(vehicle, stick_for(PLAN * 2), seed), filter_parameters_of(vehicle)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_innovations_are_white_under_the_true_ar1_coefficient_only(seed):
    measured, true = flight(seed)
    record = record_of(measured)
    _, deviate = lag_one_correlation([whole(record, true)])
    assert (np.abs(deviate) < 4.5).all()
    _, deviate = lag_one_correlation([whole(record, replace(true, noise_correlation=np.zeros(5)))])
    assert (deviate > 3.0).all()


def test_the_likelihood_peaks_at_each_instruments_ar1_coefficient():
    measured, true = flight(3)
    record = record_of(measured)
    right = whole(record, true).log_likelihood
    for k, name in enumerate(INSTRUMENTS):
        for wrong in (COLOUR[k] - 0.15, COLOUR[k] + 0.15):
            colour = np.where(np.arange(5) == k, wrong, COLOUR)
            assert whole(record, replace(true, noise_correlation=colour)).log_likelihood < right - 3.0, name


def test_lost_samples_let_the_noise_fade_as_long_as_they_are_many():
    """The same likelihood, whether ranges are lost from a record or were never in the flight."""
    measured, true = flight(4)
    full, rng = record_of(measured), np.random.default_rng(4)
    lost = rng.uniform(size=len(measured.sonar.range_m)) < 0.4
    ranges = np.where(lost, np.nan, measured.sonar.range_m)
    thinned = record_of(replace(measured, sonar=replace(measured.sonar, range_m=ranges)))
    values = full.values.copy()
    values[np.flatnonzero(full.kinds == SONAR)[lost], 0] = np.nan
    right = whole(replace(full, values=values), true).log_likelihood
    assert whole(thinned, true).log_likelihood == pytest.approx(right, abs=0.5)
    apart = np.diff(np.flatnonzero(~lost))
    assert np.array_equal(samples_between(thinned)[thinned.kinds == SONAR][1:], apart)


def test_a_tiny_ar1_coefficient_acts_as_none():
    measured, true = flight(5, np.zeros(5))
    record = record_of(measured)
    assert (ar1_states([true]) == WHITE).all()
    white, faint = whole(record, true), whole(record, replace(true, noise_correlation=np.full(5, 1e-9)))
    assert np.array_equal(white.status, faint.status)
    np.testing.assert_allclose(faint.white, white.white, atol=1e-5)
    np.testing.assert_allclose(faint.log_variance, white.log_variance, atol=1e-5)


@pytest.mark.parametrize("name", ["gyro_bias.x", "accel_bias.z", "sonar_bias.b", "vehicle.drag_1_s"])
def test_tangents_are_what_a_change_does_to_the_innovations(name):
    measured, true = flight(6)
    record, step = record_of(measured), 1e-4
    rows = list(Run(record, true, [Perturbation(name, *slot(name), step)]).segments(SEGMENT_S))
    traces = np.concatenate([r.sensitivity[:, 0] for r in rows])
    before = np.concatenate([r.white for r in rows])
    direction = Perturbation(name, *slot(name), step)
    if direction.kind == "sensor":
        other = fitted_parameter(name).stepped(true, step)
    else:
        dynamics = true.dynamics.copy()
        dynamics[direction.entry] += step
        other = replace(true, dynamics=dynamics)
    after = np.concatenate([r.white for r in Run(record, other).segments(SEGMENT_S)])
    difference = (before - after) / step
    assert np.abs(traces).max() > 1.0
    assert np.linalg.norm(traces - difference) < 0.03 * np.linalg.norm(traces)
