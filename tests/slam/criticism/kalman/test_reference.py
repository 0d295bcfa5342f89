"""Landing times and innovation variances are the same for every parameter set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter import IGNORED, USED
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import referred, whole
from slam.criticism.kalman.readings import ATTITUDE, IMU, SONAR, VELOCITY
from slam.criticism.kalman.record import record_of
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import MANOEUVRES, stick_for
from slam.simulation.model import load_model

TOUCH = next(name for name in MANOEUVRES if "touch" in name)
STARTS = ["pulse of 1 s forward at 0.25 and coast", "reversing forward at 0.2"] * 3


def vehicle(**terms):
    model = at_lower_rates(load_model("nominal"))
    for name, values in terms.items():
        model = model.with_term(name, **values)
    return model


def after_take_off(model, seed):
    """Record, healthy run, and the events of the first three ranges judged after the sonar was blind."""
    record = record_of(simulate_flight(model, stick_for([TOUCH]), seed))
    healthy = filter_parameters_of(vehicle())
    record = referred(record, healthy)
    run = whole(record, healthy)
    rows = np.flatnonzero((record.kinds == SONAR) & (run.status[:, 0] != IGNORED))
    gap = int(np.argmax(np.diff(record.times_s[rows])))
    assert record.times_s[rows[gap + 1]] - record.times_s[rows[gap]] > 1.0
    return record, run, rows[gap + 1 : gap + 4]


def test_who_stood_on_the_floor_knows_the_height():
    white = []
    for seed in range(4):
        record, run, first = after_take_off(vehicle(), seed)
        assert run.states[first[0], 10] < 0.012
        white.extend(run.white[first, 0])
        # The shock of contact is not judged, the ranges after the take-off are.
        shock = (record.kinds == IMU) & (np.abs(record.values[:, 5] - 9.81) > 5.0)
        assert shock.any()
        assert record.landing[shock].all()
        assert not record.landing[first].any()
    assert np.sqrt(np.mean(np.square(white))) < 1.6


def test_a_zero_of_the_sonar_shows_after_the_take_off():
    record, run, first = after_take_off(vehicle(sonar_bias={"b": 0.06}), 1)
    assert run.white[first[0], 0] > 3.0
    # Its landing comes earlier than the ranges say, and is not judged all the same.
    shock = (record.kinds == IMU) & (np.abs(record.values[:, 5] - 9.81) > 5.0)
    assert record.landing[shock].all()


@pytest.mark.parametrize("late_s", [pytest.param(0.05, marks=pytest.mark.slow), 0.14])
def test_a_parameter_set_gains_nothing_by_readings_that_it_ignores(late_s):
    """The greater a latency, the fewer readings beside jumps of the stick are judged."""
    truth = filter_parameters_of(vehicle(control_latency={"T": late_s}))
    record = record_of(simulate_flight(vehicle(control_latency={"T": late_s}), stick_for(STARTS), 2))
    record = referred(record, filter_parameters_of(vehicle()))
    tried = np.array([0.5, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5]) * late_s
    runs = [whole(record, replace(truth, latency_s=t)) for t in tried]
    judged = [int((run.status == USED).sum()) for run in runs]
    nats = [run.log_likelihood for run in runs]
    assert judged[0] > judged[3] > judged[-1]
    assert abs(tried[int(np.argmax(nats))] - late_s) < 0.11 * late_s
    assert nats[3] > nats[0] + 20.0


def test_a_healthy_reading_counts_nothing_on_average():
    record = referred(
        record_of(simulate_flight(vehicle(), stick_for(STARTS), 3)), filter_parameters_of(vehicle())
    )
    run = whole(record, filter_parameters_of(vehicle()))
    counted = int((run.status == USED).sum())
    assert abs(run.log_likelihood) < 4.0 * np.sqrt(counted / 2)


def test_on_the_floor_nothing_counts_but_ranges():
    record = record_of(simulate_flight(vehicle(), stick_for([TOUCH]), 1))
    record = referred(record, filter_parameters_of(vehicle()))
    status = whole(record, filter_parameters_of(vehicle())).status
    for kind in (IMU, ATTITUDE, VELOCITY):
        rows = record.kinds == kind
        landing = record.landing[rows]
        assert 0.1 < landing.mean() < 0.6
        assert (status[rows][landing] == IGNORED).all()
        assert (status[rows][~landing, 1] != IGNORED).mean() > 0.9
