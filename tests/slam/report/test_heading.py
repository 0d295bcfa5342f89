"""Doubt in a recorded heading: its drift beside what chance allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.instrument_errors import AttitudeErrors
from slam.core.streams import AttitudeSeries
from slam.report.heading import heading_doubt
from tests.slam.made_estimate import made_estimate, made_flight
from tests.slam.report.answers.asked import answers


def drifting(wander_deg: float, stated_deg: float):
    errors = AttitudeErrors(
        offset_rad=(0.0, 0.0), offset_std_rad=(0.01, 0.01), spread_rad=0.01, largest_rad=0.01,
        heading_wander_rad=np.radians(wander_deg),
    )  # fmt: skip
    estimate = made_estimate()
    stated = (0.001, 0.001, np.radians(stated_deg))
    attitude = AttitudeSeries(np.arange(4.0), np.zeros((4, 3)), stated)
    flight = replace(made_flight(), attitude=attitude)
    return replace(estimate, instruments=replace(estimate.instruments, attitude=errors)), flight


@pytest.mark.parametrize(("wander_deg", "stated_deg", "doubted"), [(16, 0.003, True), (2.0, 0.5, False)])
def test_a_drift_beyond_chance_is_doubted(wander_deg, stated_deg, doubted):
    assert bool(heading_doubt(*drifting(wander_deg, stated_deg))) is doubted


def test_the_axis_that_hangs_on_it_is_no_sure_direction():
    told = answers(*drifting(16, 0.003))
    assert (
        "do not take x for a direction of a compass"
        in told["Which way do x and y point, and where is north?"]
    )
    promise = "What does the status promise, and what not?"
    assert "or “What failed?” below names is excepted" in told[promise]
    assert "drifts by 16.0° over the flight" in told["What failed?"]
    assert "No instrument is doubted" not in told["What failed?"]
