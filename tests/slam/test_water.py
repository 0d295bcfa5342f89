"""Maps of ground with water: its waves are others in each picture, so that no two agree on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.cli.results import _ground_messages
from slam.core.geodesy import enu_from_geodetic
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.slam.photo_survey import ORIGIN, photographed, picture, poses, with_water

WATER_M = (2.0, 14.0, 4.0, 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("has_water", [True, False])
def test_water_is_told_with_its_share_and_place(has_water, tmp_path):
    rng = np.random.default_rng(3)
    w_T_c = poses(4, 3, rng)
    flight = photographed(w_T_c, rng, 0.3)
    if has_water:
        shown = [picture(T, floor=with_water(*WATER_M, k)) for k, T in enumerate(w_T_c)]
        flight = replace(flight, frames=replace(flight.frames, load=lambda k: shown[k]))
    estimate = optimize(flight)
    assert estimate.placed.all()
    facts = write_mosaic(estimate, flight, tmp_path).ground.facts
    assert facts.relief_share == 0
    if not has_water:
        assert (facts.unmatched_share, facts.unmatched_at_m) == (0.0, None)
        return
    assert 0.05 < facts.unmatched_share < 0.2
    shift = enu_from_geodetic(ORIGIN.latitude_deg, ORIGIN.longitude_deg, ORIGIN.altitude_m, estimate.origin)
    x, y = np.array(facts.unmatched_at_m) - np.ravel(shift)[:2]
    west, east, south, north = WATER_M
    assert west < x < east
    assert south < y < north
    (message,) = _ground_messages(facts, True)
    assert "nothing tells heights there" in message
