"""The filter under changes of its noise, all in one run, is the filter run anew under each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter import USED
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import Run, whole
from slam.criticism.kalman.record import record_of
from slam.criticism.search.effects import effects_for
from slam.criticism.search.fitted_parameters import NOISE_NUISANCES
from slam.criticism.search.fitting import ar1_effects, first_parts
from slam.simulation.healthy.flights import at_lower_rates, simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model

AR1 = np.array([0.3, 0.0, 0.2, 0.0, 0.1])
"""Correlations of the gyro's, the attitude's and the sonar's noise; the others are white."""

CURVED = 0.02
"""Share of a change by the equations' curvature, which the common Jacobians lack: 1.1 % at most."""


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [0.0 * AR1, AR1])
def test_changes_of_the_noise_are_the_filter_run_anew(correlation):
    model = at_lower_rates(load_model("nominal"))
    record = record_of(simulate_flight(model, stick_for(["tilts of 15 deg to all four sides"]), 50))
    (record,) = first_parts([record], 6.0)
    parameters = replace(filter_parameters_of(model), noise_correlation=correlation)
    effects = [*effects_for([record], parameters), *ar1_effects(parameters)]
    changes = [*NOISE_NUISANCES, *(c for e in effects for c in e.changes)]
    (rows,) = Run(record, parameters, changed=[c.stepped(parameters, c.step) for c in changes]).segments(
        np.inf
    )
    plain = whole(record, parameters)
    used = plain.status == USED
    for k, change in enumerate(changes):
        anew = whole(record, change.stepped(parameters, change.step))
        both = (anew.status == USED)[used]
        wider = (anew.log_variance - plain.log_variance)[used][both]
        moved = plain.white[used][both] - anew.white[used][both] * np.exp(0.5 * wider)
        for found, true in (
            (rows.change_of_mean[both, k], moved),
            (rows.change_of_log_variance[both, k], wider),
        ):
            assert np.linalg.norm(found - true) < CURVED * np.linalg.norm(true), change.name
