"""Too many outliers are not due to chance, and no cause either: they are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.innovations import whole
from slam.criticism.kalman.readings import ATTITUDE
from slam.criticism.kalman.record import record_of
from slam.criticism.verdict.commanded_flights import outliers_of
from slam.simulation.healthy.flights import simulate_flight
from slam.simulation.healthy.manoeuvres import stick_for
from slam.simulation.model import load_model


@pytest.mark.parametrize(("share", "reported"), [(0.0, False), (0.02, False), (0.1, True)])
def test_a_share_that_no_noise_makes_is_reported(share, reported):
    model = load_model("nominal")
    record = record_of(simulate_flight(model, stick_for(["climb and descend by 0.6 m"]), 1))
    values, rng = record.values.copy(), np.random.default_rng(2)
    rolls = np.flatnonzero(record.kinds == ATTITUDE)
    values[rng.choice(rolls, int(share * len(rolls)), replace=False), 0] += 0.3
    record = replace(record, values=values)
    found = outliers_of([whole(record, filter_parameters_of(model))])
    assert bool(found) == reported
    assert all("readings of roll are far" in remark.text for remark in found)
