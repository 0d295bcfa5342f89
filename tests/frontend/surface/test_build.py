"""The surface of a map, from pictures of a plane at a known height."""

from dataclasses import replace

import numpy as np
import pytest

from frontend.elevation import Elevation
from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.surface import HeightSource
from frontend.surface.build import build_surface
from frontend.workers import Workers, share_with
from tests.frontend.mosaic.scene import FLOOR_Z_M
from tests.frontend.sent_workers import SentWorkers
from tests.frontend.surface.raised_plane import CAMERA, GSD_M, HEIGHT_M, POSES, measured, photographs


@pytest.fixture(scope="module")
def pictures():
    return photographs()


def test_over_the_measured_surface_pictures_agree(pictures):
    floor_z_m = FLOOR_Z_M - HEIGHT_M
    plan, before = measured(pictures, POSES, floor_z_m)
    everywhere = np.ones(before.shape, bool)
    surface = build_surface(plan, Pictures(plan, pictures.__getitem__), everywhere, None)
    known = surface.source == HeightSource.PICTURES
    off_m = np.abs(surface.height_m[known] - HEIGHT_M)
    assert (off_m < 0.05).sum() > 0.38 * known.size
    assert np.median(off_m) < 0.01
    assert np.percentile(off_m, 95) < 0.025, "heights that one pair alone tells are checked: else 0.03 m"
    # Two in three are within a deviation; smoothing afterwards makes them better than told.
    assert 0.65 < np.mean(off_m < surface.std_m[known]) < 0.9
    _, after = measured(pictures, POSES, floor_z_m, surface)
    assert after.percentile_px(50) < 0.3 < 2 < before.percentile_px(50)


@pytest.mark.slow
def test_a_surface_does_not_depend_on_the_workers(pictures):
    plan, before = measured(pictures, POSES, FLOOR_Z_M - HEIGHT_M)
    plan, everywhere = replace(plan, tile_px=8 * CELL_PX), np.ones(before.shape, bool)
    assert len(list(plan.tiles)) > 2
    found = []
    for chosen in (Workers(1), Workers(2), SentWorkers(2)):
        with share_with(chosen):
            found.append(build_surface(plan, Pictures(plan, pictures.__getitem__), everywhere, None))
    assert (found[0].source == HeightSource.PICTURES).mean() > 0.2
    for other in found[1:]:
        np.testing.assert_array_equal(other.height_m, found[0].height_m)
        np.testing.assert_array_equal(other.std_m, found[0].std_m)


@pytest.mark.slow
def test_a_surface_larger_than_memory_has_larger_cells(pictures, monkeypatch):
    monkeypatch.setattr("frontend.surface.build.MOST_CELLS", 20_000)
    plan, before = measured(pictures, POSES, FLOOR_Z_M - HEIGHT_M)
    everywhere = np.ones(before.shape, bool)
    surface = build_surface(plan, Pictures(plan, pictures.__getitem__), everywhere, None)
    assert surface.height_m.size <= 20_000 < plan.width * plan.height / 4
    assert surface.cell_m == pytest.approx(4 * GSD_M)
    known = surface.source == HeightSource.PICTURES
    assert np.median(np.abs(surface.height_m[known] - HEIGHT_M)) < 0.02, "cells of twice the side"


def test_the_sonar_fills_what_pictures_did_not_measure(pictures):
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, 0.01)
    sonar = Elevation(-3.0, 3.0, 0.1, np.full((60, 60), 0.07, np.float32))
    dark = np.zeros((240, 320, 3), np.uint8)
    views = Pictures(plan, lambda k: dark)  # unusable: nothing matches
    surface = build_surface(plan, views, np.ones((2, 2), bool), sonar)
    assert (surface.source == HeightSource.SONAR).any()
    assert surface.height_m[surface.source == HeightSource.SONAR] == pytest.approx(0.07)


def test_ground_that_no_two_pictures_show_is_taken_as_level_and_told():
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, 0.01)
    dark = np.zeros((240, 320, 3), np.uint8)
    views = Pictures(plan, lambda k: dark)  # unusable: nothing matches
    relief, compared = np.zeros((2, 2), bool), np.array([[True, True], [True, False]])
    relief[0, 0] = True
    surface = build_surface(plan, views, relief, None, compared=compared)
    sources = surface.source[0, 0], surface.source[0, -1], surface.source[-1, -1]
    assert sources == (HeightSource.FILLED, HeightSource.FLOOR, HeightSource.LEVEL)
    assert surface.height_m[-1, -1] == 0.0
    assert surface.on_floor[-1, -1]
    assert not surface.on_floor[0, 0]
    everything = build_surface(plan, views, relief, None)
    assert not (everything.source == HeightSource.LEVEL).any()
