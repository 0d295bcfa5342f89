"""The surface that a report draws and measures: what no picture shows, and what the mosaic shows once."""

from dataclasses import replace

import numpy as np
import pytest

from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.misregistration import (
    SQUARE_PX,
    seen_by_two,
)
from slam.core.progress import silent
from slam.report.rasters.surface import measure_ground, without_unseen
from tests.frontend.mosaic.scene import FLOOR_Z_M
from tests.frontend.surface.raised_plane import CAMERA, GSD_M, HEIGHT_M, POSES, photographs


@pytest.fixture(scope="module")
def pictures():
    return photographs()


def test_ground_that_no_picture_shows_is_marked():
    plan = plan_mosaic(CAMERA, POSES[:1], FLOOR_Z_M, GSD_M)
    heights = np.full((300, 400), 0.1, np.float32)
    source = np.full(heights.shape, HeightSource.FILLED, np.uint8)
    wide = Surface(plan.west_m - 1.0, plan.north_m + 1.0, 0.0125, heights, heights, source)
    marked = without_unseen(wide, plan)
    assert marked.height_m is heights
    r, c = np.nonzero(marked.source != HeightSource.UNSEEN)
    x, y = wide.west_m + (c + 0.5) * wide.cell_m, wide.north_m - (r + 0.5) * wide.cell_m
    assert (marked.source[r, c] == HeightSource.FILLED).all()
    west, south, east, north = plan.views[0].bounds_m
    cell_m = CELL_PX * GSD_M
    assert west - cell_m < x.min()
    assert x.max() < east + cell_m
    assert south - cell_m < y.min()
    assert y.max() < north + cell_m
    assert len(r) * wide.cell_m**2 == pytest.approx(np.count_nonzero(plan.owner >= 0) * cell_m**2, rel=0.02)


@pytest.mark.slow
def test_ground_that_the_mosaic_shows_once_is_measured_where_other_pictures_show_it(pictures):
    floor_z_m = FLOOR_Z_M - HEIGHT_M
    whole = plan_mosaic(CAMERA, POSES, floor_z_m, GSD_M / 2)  # enough squares for a decision
    fewer = replace(whole, views=whole.views[:4])
    load = pictures.__getitem__
    found = measure_ground(fewer, Pictures(fewer, load), np.array(POSES), None, silent)
    compared = found.over_floor.compared
    assert (seen_by_two(whole) & ~compared).any()
    source = found.surface.source
    cells = SQUARE_PX * whole.gsd_m / found.surface.cell_m  # along a square
    for row, column in ((np.argwhere(seen_by_two(whole) & ~compared) + 0.5) * cells).astype(int):
        assert source[row, column] != HeightSource.FLOOR
