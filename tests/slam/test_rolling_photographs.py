"""Photographs of which the rows are exposed one after the other, from pixels to the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.geodesy import enu_from_geodetic
from slam.core.summary import summarise
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.photo_survey import ORIGIN, photographed, poses

READOUT_S = 0.03
EVERY_S = 0.9
"""9 m from picture to picture: 10 m/s, at which 30 ms are 0.3 m or five pixels."""


def mapped(readout_s: float) -> tuple[Estimate, np.ndarray, Flight]:
    """The map of a survey, the errors (n, 3) of its cameras in metres, and the flight."""
    rng = np.random.default_rng(4)
    w_T_c = poses(6, 3, rng)
    flight = photographed(w_T_c, rng, 0.02, every_s=EVERY_S, readout_s=readout_s)
    estimate = optimize(flight)
    shift = enu_from_geodetic(ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m, estimate.origin)
    return estimate, estimate.w_T_b[:, :3, 3] - w_T_c[:, :3, 3] - shift, flight


@pytest.mark.slow
def test_a_rolling_shutter_is_estimated_and_a_global_one_is_not(tmp_path):
    rolling, off_m, flight = mapped(READOUT_S)
    once, off_once_m, _ = mapped(0.0)
    found, fixed = rolling.instruments.rolling_shutter, once.instruments.rolling_shutter
    assert found.estimated
    assert abs(found.readout_s - READOUT_S) < 2 * found.std_s
    assert (fixed.estimated, fixed.readout_s) == (False, 0.0)
    assert summarise(rolling).to_json()["rolling_shutter"]["estimated"] is True
    rms_m, rms_once_m = (np.sqrt(np.mean(np.sum(off**2, axis=1))) for off in (off_m, off_once_m))
    assert rms_m < 0.06, "0.16 m with all rows as if exposed at once"
    assert rms_once_m < 0.03
    drawn, bent = (
        np.nanmedian(np.linalg.norm(write_mosaic(each, flight, tmp_path).ground.over_floor.shift_px, axis=1))
        for each in (rolling, replace(rolling, row_motion_m=None))
    )
    assert drawn < 0.5 * bent, "in pixels, between two pictures of one piece of ground"
