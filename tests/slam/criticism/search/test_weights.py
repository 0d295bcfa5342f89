"""Gain corrections are free: otherwise heavy tails resemble a pattern of the tilt target."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.record import record_of
from slam.criticism.search.effects import residual_patterns
from slam.criticism.search.fitted_parameters import (
    MEAN_NUISANCES,
    NOISE_NUISANCES,
    NUISANCES,
    fitted_parameter,
    gain_column,
)
from slam.criticism.search.information import fisher_information
from slam.criticism.search.quadratic_likelihood import QuadraticLikelihood
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

BEHIND_TILT = ("force pitch ~ pitch", "force roll ~ roll")
TILT = gain_column("tilt_std_rad")


@pytest.fixture(scope="module")
def seen():
    """Fisher information of one healthy flight with two tilt patterns, and the parameters."""
    model = at_lower_rates(load_model("nominal"))
    record = record_of(simulate_flight(model, stick_for(["tilts of 15 deg to all four sides"]), 50))
    parameters = filter_parameters_of(model)
    patterns = [e for e in residual_patterns([record]) if e.name in BEHIND_TILT]
    return fisher_information([record], parameters, patterns, NUISANCES, True), parameters


def share_left(fisher, column, out):
    information = fisher.information.sum(axis=0)
    own, out = fisher.columns.index(column), [fisher.columns.index(name) for name in out]
    taken = np.linalg.solve(information[np.ix_(out, out)], information[out, own])
    return 1.0 - information[own, out] @ taken / information[own, own]


def test_a_wrong_gain_is_a_target_that_goes_with_tilt(seen):
    fisher, _ = seen
    vehicle = [n.name for n in MEAN_NUISANCES[:3]]
    assert share_left(fisher, TILT, vehicle) > 0.5
    assert share_left(fisher, TILT, [*vehicle, *BEHIND_TILT]) < 0.1
    # The scatter tells the size of the unrest all the same.
    assert share_left(fisher, "tilt_std_rad", [*vehicle, *BEHIND_TILT]) > 0.3


def test_gain_corrections_are_free_and_no_parameters(seen):
    fisher, parameters = seen
    quadratic = QuadraticLikelihood(fisher, parameters, parameters)
    maximum = quadratic.maximise([])
    assert {gain_column(n.name) for n in NOISE_NUISANCES} <= set(quadratic.names)
    assert maximum.step[quadratic.names.index(TILT)] != 0.0
    assert fitted_parameter(TILT).stepped(parameters, 0.1) is parameters
