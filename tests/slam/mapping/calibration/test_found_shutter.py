"""Read-out time of a video: what a map has found of it, and what the next one is made with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from backend.bundle.rolling_shutter import ReadoutEstimate
from slam.core.units import SPACE
from slam.mapping.calibration.found_shutter import refuted_shutter_warning, with_found_shutter
from slam.mapping.calibration.rolling_shutter import frames_exposure
from tests.slam.mapping.made_map import CAMERA

FOUND = ReadoutEstimate(0.018, 0.0002, 0.04, None, is_estimated=True, known_velocities=40)


def map_with(found: ReadoutEstimate | None) -> SimpleNamespace:
    return SimpleNamespace(bundle=SimpleNamespace(readout=found))


@pytest.mark.parametrize(("stated_s", "assumed_s"), [(None, 0.0), (0.03, 0.03)])
def test_the_next_map_begins_with_the_time_that_was_found(stated_s: float | None, assumed_s: float):
    camera = replace(CAMERA, readout_s=assumed_s)
    again = with_found_shutter(camera, map_with(replace(FOUND, stated_s=stated_s)))
    assert (again.readout_s, again.stated_readout_s) == (0.018, assumed_s)
    last = with_found_shutter(again, map_with(replace(FOUND, readout_s=0.017, stated_s=stated_s)))
    assert (last.readout_s, last.stated_readout_s) == (0.017, assumed_s)
    assert with_found_shutter(last, map_with(replace(FOUND, readout_s=0.0171))) is None, "hardly another"


@pytest.mark.parametrize("found", [None, replace(FOUND, readout_s=0.0, is_estimated=False)])
def test_a_time_that_stays_fixed_changes_nothing(found: ReadoutEstimate | None):
    assert with_found_shutter(CAMERA, map_with(found)) is None


def test_the_frames_of_a_video_tell_how_its_rows_are_exposed():
    seen = SimpleNamespace(corner_speed=np.ones((5, 4, 2)))
    exposure = frames_exposure(seen, CAMERA)
    assert (exposure.rows, exposure.readout_s, exposure.corrected_s) == (240, None, 0)
    assert not exposure.is_refuted
    np.testing.assert_allclose(exposure.xy[0], [-159.5 / 250, -119.5 / 250])
    found = frames_exposure(seen, replace(CAMERA, readout_s=0.018, stated_readout_s=0.03))
    assert (found.readout_s, found.corrected_s, found.is_refuted) == (0.03, 0.018, True)
    unstated = frames_exposure(seen, replace(CAMERA, readout_s=0.018, stated_readout_s=0.0))
    assert (unstated.readout_s, unstated.corrected_s, unstated.is_refuted) == (None, 0.018, True)
    assert frames_exposure(SimpleNamespace(corner_speed=np.empty((0, 4, 2))), CAMERA) is None


def test_a_stated_time_that_is_refuted_is_told_with_the_one_found():
    said = refuted_shutter_warning(SimpleNamespace(readout=replace(FOUND, stated_s=0.03)), "sensor.yaml")
    assert str(said).replace(SPACE, " ") == (
        "cam0: the stated read-out time of the shutter, 30 ms, contradicts the pictures; this map has "
        "18.00 ± 0.20 ms instead, as estimated from them; correct readout in sensor.yaml"
    )
    assert refuted_shutter_warning(SimpleNamespace(readout=FOUND), "sensor.yaml") is None
    kept = replace(FOUND, stated_s=0.03, is_estimated=False)
    assert refuted_shutter_warning(SimpleNamespace(readout=kept), "sensor.yaml") is None
