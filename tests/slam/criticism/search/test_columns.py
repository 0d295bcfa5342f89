"""A step of a column is what the belief then holds more, and taking it all out leaves a healthy vehicle."""

from __future__ import annotations

import pytest

from slam.criticism.kalman.setting import setting_of
from slam.criticism.search.columns import bounded, column_of
from slam.criticism.search.nuisances import NUISANCES, value_of
from slam.simulation.model import load_model
from slam.simulation.terms import CATALOGUE

NOMINAL = setting_of(load_model("nominal"))
FREE = {
    "quadratic_drag.c": (0.1, 0.1),
    "sonar_scale.eps": (-0.02, -0.02),
    "focal_length.eps": (0.01, 0.01),
    "motion_blur.exposure": (4e-4, 0.02),
    "control_latency.T": (0.05, 0.05),
    "clock_drift.ppm": (2e-4, 200.0),
    "timestamp_jitter.var": (9.0, 0.003),
    "ground_effect.radius": (0.01, 0.1),
    "gusts@0.7": (0.04, 0.2),
}
"""Step of a column -> the same in the catalogue's unit."""


@pytest.mark.parametrize("name", FREE)
def test_a_step_is_held_told_and_taken_out_again(name):
    column = column_of(name)
    step, told = FREE[name]
    changed = column.moved(NOMINAL, step)
    assert column.held(changed) == pytest.approx(column.held(NOMINAL) + step, rel=1e-12)
    assert column.in_catalogue(column.held(changed), changed) == pytest.approx(told, rel=1e-12)
    assert column.held(column.moved(changed, -column.held(changed))) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("name", "value"), [("control_latency@0.08", 0.08), ("tilt_limit@0.2", 0.2)])
def test_a_value_on_a_grid_is_taken_whatever_the_step(name, value):
    column = column_of(name)
    for step in (-3.0, 1.0):
        changed = column.moved(NOMINAL, step)
        assert column.in_catalogue(column.held(changed), changed) == pytest.approx(value)


def test_no_step_goes_beyond_what_the_equations_bear():
    drag = CATALOGUE["quadratic_drag"].parameter("c")
    bare = column_of("quadratic_drag.c")
    assert bare.held(bare.moved(NOMINAL, -100.0)) == drag.least
    assert column_of("control_latency.T").moved(NOMINAL, -1.0).latency_s == 0.0
    assert column_of("timestamp_jitter.var").moved(NOMINAL, -1.0).jitter_s == 0.0
    assert bounded("quadratic_drag.c", 100.0, NOMINAL) == drag.high - drag.low
    assert bounded("vehicle.gain", -9.0, NOMINAL) == pytest.approx(-0.4 * value_of(NUISANCES[0], NOMINAL))
    assert bounded("gusts@2.5", 9.0, NOMINAL) == 9.0


def test_gusts_of_another_time_are_not_these():
    blown = column_of("gusts@0.7").moved(NOMINAL, 0.04)
    assert column_of("gusts@2.5").held(blown) == 0.0
    assert column_of("gusts@2.5").moved(blown, 0.05).hold[-2:] == pytest.approx([0.3, 2.5])


def test_what_is_off_in_the_gains_is_nothing_that_a_belief_holds():
    assert column_of("weight of gyro_noise").moved(NOMINAL, 0.3) is NOMINAL
