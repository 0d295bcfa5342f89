"""Ground of unknown height is filled in from around, and single wrong heights are removed."""

from dataclasses import replace

import numpy as np
import pytest

from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.holes import filled, without_specks
from tests.frontend.surface.raised_plane import boxed


def test_holes_are_filled_from_the_ground_not_from_the_roof():
    surface = boxed()
    heights, source = surface.height_m.copy(), surface.source.copy()
    heights[18:37, 40:44], source[18:37, 40:44] = np.nan, HeightSource.FILLED
    whole = filled(replace(surface, height_m=heights, source=source))
    assert np.isfinite(whole.height_m).all()
    assert np.abs(whole.height_m[20:35, 41:44]).max() < 1e-6
    assert whole.height_m[21:34, 27:38].min() == pytest.approx(0.5)


def test_specks_are_removed_and_roofs_stay():
    heights = boxed().height_m.copy()
    heights[5:9, 5:9], heights[50:52] = 7.0, np.nan
    kept = without_specks(heights, 0.1)
    assert np.isnan(kept[5:9, 5:9]).all()
    kept[5:9, 5:9] = heights[5:9, 5:9]
    np.testing.assert_array_equal(kept, heights)


def test_a_long_hole_is_filled_from_what_is_beside_each_part_of_it():
    """A band of unknown height across a slope: each cell has the height of the slope beside it."""
    slope = np.tile(np.linspace(0.0, 3.0, 200, dtype=np.float32), (60, 1))
    holed = slope.copy()
    holed[25:31] = np.nan
    source = np.where(np.isnan(holed), HeightSource.FILLED, HeightSource.PICTURES).astype(np.uint8)
    whole = filled(Surface(0.0, 0.0, 0.02, holed, np.zeros_like(holed), source))
    assert np.abs(whole.height_m - slope).max() < 0.3
