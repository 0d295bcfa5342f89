"""A step of a column changes the parameters by as much, and undoing all steps gives a healthy vehicle."""

from __future__ import annotations

import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.search.fitted_parameters import AR1_COEFFICIENTS, NUISANCES, fitted_parameter
from slam.simulation.model import load_model
from slam.simulation.terms import CATALOGUE

NOMINAL = filter_parameters_of(load_model("nominal"))
FREE = {
    "quadratic_drag.c": (0.1, 0.1),
    "sonar_scale.eps": (-0.02, -0.02),
    "focal_length.eps": (0.01, 0.01),
    "motion_blur.exposure": (4e-4, 0.02),
    "control_latency.T": (0.05, 0.05),
    "clock_drift.ppm": (2e-4, 200.0),
    "timestamp_jitter.var": (9e-6, 0.003),
    "ground_effect.radius": (0.01, 0.1),
    "gusts@0.7": (0.04, 0.2),
}
"""Step of a column -> the same in the catalogue's unit."""


@pytest.mark.parametrize("name", FREE)
def test_a_nuisance_step_is_stored_read_and_undone(name):
    column = fitted_parameter(name)
    step, reported = FREE[name]
    changed = column.stepped(NOMINAL, step)
    assert column.size_in(changed) == pytest.approx(column.size_in(NOMINAL) + step, rel=1e-12)
    assert column.in_catalogue_units(column.size_in(changed), changed) == pytest.approx(reported, rel=1e-12)
    assert column.size_in(column.stepped(changed, -column.size_in(changed))) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("name", "value"), [("control_latency@0.08", 0.08), ("tilt_limit@0.2", 0.2)])
def test_a_value_on_a_grid_is_taken_whatever_the_step(name, value):
    column = fitted_parameter(name)
    for step in (-3.0, 1.0):
        changed = column.stepped(NOMINAL, step)
        assert column.in_catalogue_units(column.size_in(changed), changed) == pytest.approx(value)


def test_no_step_goes_beyond_what_the_equations_bear():
    drag = CATALOGUE["quadratic_drag"].parameter("c")
    bare = fitted_parameter("quadratic_drag.c")
    assert bare.size_in(bare.stepped(NOMINAL, -100.0)) == drag.least
    assert fitted_parameter("control_latency.T").stepped(NOMINAL, -1.0).latency_s == 0.0
    assert fitted_parameter("timestamp_jitter.var").stepped(NOMINAL, -1.0).jitter_s == 0.0
    assert bare.bounded(100.0, NOMINAL) == drag.high - drag.low
    assert NUISANCES[0].bounded(-9.0, NOMINAL) == pytest.approx(-0.4 * NUISANCES[0].value_in(NOMINAL))
    assert fitted_parameter("gusts@2.5").bounded(9.0, NOMINAL) == 9.0


def test_gusts_of_another_time_are_not_these():
    blown = fitted_parameter("gusts@0.7").stepped(NOMINAL, 0.04)
    assert fitted_parameter("gusts@2.5").size_in(blown) == 0.0
    assert fitted_parameter("gusts@2.5").stepped(blown, 0.05).hold[-2:] == pytest.approx([0.3, 2.5])


def test_gain_corrections_are_no_parameters():
    assert fitted_parameter("weight of gyro_noise").stepped(NOMINAL, 0.3) is NOMINAL


@pytest.mark.parametrize("name", ["tilt_limit.limit", "control_latency.T", "sonar_slant.c"])
def test_a_removed_effect_leaves_no_rounding_error(name):
    column = fitted_parameter(name)
    changed = NOMINAL
    for step in (-1.3, 0.017, 0.0703):
        changed = column.stepped(changed, step)
    assert column.size_in(changed) != 0.0
    assert column.size_in(column.without_effect(changed)) == 0.0


def test_the_derivative_at_the_greatest_value_is_backward():
    coefficient = AR1_COEFFICIENTS[0]
    for x in (0.0, 0.5, coefficient.most):
        at = coefficient.at(NOMINAL, x)
        assert coefficient.stepped(at, coefficient.difference(at)).noise_correlation[0] != x
