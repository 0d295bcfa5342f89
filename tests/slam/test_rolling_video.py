"""A video of which the rows are exposed one after the other, from pixels to the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.summary import summarise
from slam.evaluation.score import evaluate
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.small_flight import flown

READOUT_S = 0.018


def simulated(readout_s: float) -> Flight:
    """A brisk flight whose camera states nothing of its shutter."""
    terms = {"rolling_shutter": {"readout": readout_s}} if readout_s else {}
    return flown(2, terms=terms, maneuver={"cruise_m_s": 0.8})


def stating(flight: Flight, readout_s: float) -> Flight:
    return replace(flight, camera=replace(flight.camera, readout_s=readout_s))


def error_m(estimate: Estimate, flight: Flight) -> float:
    return evaluate(estimate, flight).ate_m.rmse


@pytest.mark.slow
def test_a_read_out_time_that_is_not_stated_is_estimated(tmp_path):
    flight = simulated(READOUT_S)
    found, told = optimize(flight), optimize(stating(flight, READOUT_S))
    shutter = found.instruments.rolling_shutter
    assert shutter.estimated
    assert abs(shutter.readout_s - READOUT_S) < 3 * shutter.std_s + 0.02 * READOUT_S
    assert not told.instruments.rolling_shutter.estimated
    assert error_m(found, flight) < 1.5 * error_m(told, flight) + 0.001, "25 mm with a global shutter"
    assert not any("accelerometer" in message for message in map(str, found.messages))
    assert summarise(found).to_json()["rolling_shutter"]["estimated"] is True
    drawn, bent = (
        np.nanmedian(np.linalg.norm(write_mosaic(each, flight, tmp_path).ground.over_floor.shift_px, axis=1))
        for each in (found, replace(found, row_motion_m=None))
    )
    assert drawn < bent, "in pixels, between two pictures of one piece of ground"


@pytest.mark.slow
def test_a_stated_read_out_time_that_is_wrong_is_told_and_replaced():
    flight = simulated(READOUT_S)
    found = optimize(stating(flight, 0.03))
    shutter = found.instruments.rolling_shutter
    assert (shutter.estimated, shutter.stated_s) == (True, 0.03)
    assert shutter.readout_s == pytest.approx(READOUT_S, rel=0.03)
    assert any(
        "the stated read-out time of the shutter, 30 ms, contradicts" in str(m) for m in found.messages
    )


@pytest.mark.slow
def test_a_global_shutter_stays_one():
    shutter = optimize(simulated(0.0)).instruments.rolling_shutter
    assert (shutter.estimated, shutter.readout_s) == (False, 0.0)
