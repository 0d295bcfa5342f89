"""Readings that lag: by a delay, by a filter, or by less than a sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.without_commands.explanation import search_linear
from slam.criticism.without_commands.likelihood import likelihood_of
from slam.data_quality.inertial_comparison import NODE_S
from slam.data_quality.lag import Lag
from slam.data_quality.whitened_rows import inertial_residuals, lags_of
from slam.simulation.healthy.flights import healthy_case, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model
from tests.slam.criticism.without_commands.unsteered import delayed, expansion_of, flights


@pytest.mark.parametrize("seed", [9502, 9538])
def test_a_rate_that_jumps_between_two_samples_is_no_scale_of_the_gyro(seed):
    flight = replace(healthy_case(load_model("nominal"), seed, 1, 30.0)[0], command=None)
    assert score([inertial_residuals(flight)], "gyro_scale").z < 3.2


def score(rows, name):
    """The score test of one effect alone."""
    expansion = expansion_of(rows)
    return expansion.score_tests([], [e for e in expansion.effects if e.name == name])[0]


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


def test_a_reading_a_little_late_of_an_even_clock_does_not_show_what_runs_away():
    """Of an accelerometer that is off, what is integrated twice is hundreds of metres after a minute."""
    model = load_model("nominal")
    plan = ["climb and descend by 0.6 m", "hover for 8 s"] * 5
    flight = simulate_flight(model.with_term("accel_bias", z=0.3), stick_for(plan), 3, maker=model)
    (height,) = (r.averages for r in inertial_residuals(flight) if r.kind == "height")
    column = height.table[:, height.column("accel_bias.z")]
    curved = (column[2:] - 2.0 * column[1:-1] + column[:-2]) / NODE_S**2
    np.testing.assert_allclose(curved, -1.0, atol=0.1)
