"""Shapes: what acts ahead acts to the left as well, unless it minds which way is ahead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.criticism.kalman.record import record_of
from slam.criticism.search.effects import (
    LEVEL_SIGNALS,
    LEVEL_TARGETS,
    YAW_AT_PLACE,
    residual_patterns,
    signals_of,
)
from slam.simulation.dynamics import PITCH, ROLL
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


def test_yaw_is_not_laid_to_a_place_that_nothing_measured():
    flight = simulate_flight(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    blind = record_of(replace(flight, velocity=None))
    assert any(e.name == YAW_AT_PLACE for e in residual_patterns([record_of(flight)]))
    assert not any(e.name == YAW_AT_PLACE for e in residual_patterns([blind]))


def test_each_direction_has_its_shape_and_level_ones_one_together():
    flight = simulate_flight(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    patterns = residual_patterns([record_of(flight)])
    alone = [s for s in patterns if len(s.columns) == 1]
    together = [s for s in patterns if len(s.columns) == 2]
    names = {s.name for s in alone}
    assert names == {c for s in alone for c in s.columns}
    assert [s.name for s in patterns if len(s.columns) > 2] == [YAW_AT_PLACE]
    assert len(alone) + len(together) == len(patterns) - 1
    # Sticks are not led into instruments, high speeds into none but that which reads them; rates of tilts
    # into no forces.
    assert len(together) == len(LEVEL_TARGETS) * len(LEVEL_SIGNALS) - 4 - 5 - 2
    assert all(set(s.columns) <= names for s in together)
    assert len({s.name for s in patterns}) == len(patterns)
    # One column ahead, the other to the left, of the same kind.
    columns = {s.columns for s in together}
    assert ("force ahead ~ pitch", "force left ~ roll") in columns
    assert ("gyro_y ~ ahead", "gyro_x ~ left") in columns
    assert ("velocity_x ~ ahead when fast", "velocity_y ~ left when fast") in columns
    assert not any(s.columns[0] == s.columns[1] for s in together)


def test_place_is_each_flights_own_and_counts_from_where_it_begins():
    record = record_of(
        simulate_flight(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    )
    states = np.zeros((len(record.times_s), 10))
    states[:, 0] = 5.0 + record.times_s
    signals = signals_of(record, states, 1, 2)
    moved = record.times_s - record.times_s[0]
    np.testing.assert_allclose(signals["x of flight 1"][1], moved)
    np.testing.assert_allclose(signals["r2 of flight 1"][1], moved**2)
    assert not signals["x of flight 0"][1].any()
    (placed,) = [s for s in residual_patterns([record, record]) if s.name == YAW_AT_PLACE]
    assert sorted(d.signal for d in placed.perturbations) == sorted(s for s in signals if "of flight" in s)


def test_what_happens_when_fast_is_nothing_at_half_the_highest_speed_and_goes_where_it_goes():
    record = record_of(
        simulate_flight(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    )
    states = np.zeros((len(record.times_s), 10))
    states[:, 3] = np.linspace(-2.0, 2.0, len(states))
    reported = signals_of(record, states)["ahead when fast"][1]
    assert not reported[np.abs(states[:, 3]) < 1.1].any()
    np.testing.assert_array_equal(np.sign(reported[[0, -1]]), [-1.0, 1.0])
    assert not signals_of(record, states)["left when fast"][1].any()


def test_the_rate_of_a_tilt_is_a_signal():
    record = record_of(
        simulate_flight(load_model("nominal"), stick_for(["yaw on the spot while climbing"]), 1)
    )
    states = np.zeros((len(record.times_s), 10))
    states[:, PITCH], states[:, ROLL] = np.sin(2.0 * record.times_s), 0.5 * record.times_s
    signals = signals_of(record, states)
    inside = slice(10, -10)
    slope = 2.0 * np.cos(2.0 * (record.times_s - 0.01))
    np.testing.assert_allclose(signals["pitching"][1][inside], slope[inside], atol=2e-3)
    np.testing.assert_allclose(signals["rolling"][1][inside], 0.5, atol=1e-9)
    # Nothing of what comes after.
    states[200:, PITCH] = 9.0
    before = signals_of(record, states)["pitching"][1][:200]
    np.testing.assert_array_equal(before, signals["pitching"][1][:200])
