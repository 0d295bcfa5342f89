"""Groups of squares in which no two pictures agree: those that chance does not make."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.mosaic.canvas import MosaicGrid
from frontend.surface.disagreement import Disagreement, disagreement, groups_beyond_chance
from frontend.surface.misregistration import SQUARE_PX, Misregistration


def measured(failed: np.ndarray) -> Misregistration:
    square = np.argwhere(np.ones_like(failed))
    shift_px = np.where(failed.reshape(-1, 1), np.nan, 0.1) * np.ones(2)
    return Misregistration(failed.shape, square, shift_px, np.ones((len(square), 2)))


@pytest.mark.parametrize("share", [0.0, 0.02, 0.1, 0.3])
def test_squares_that_fail_by_chance_are_no_group(share):
    """Of flat maps at most one in twenty has a group."""
    rng = np.random.default_rng(3)
    maps = [groups_beyond_chance(measured(rng.random((30, 40)) < share)) for _ in range(40)]
    assert sum(map(bool, maps)) <= 2


def test_a_lake_and_a_pond_are_found_among_single_failures():
    failed = np.random.default_rng(1).random((30, 40)) < 0.02
    failed[3:9, 5:14], failed[20:23, 30:34] = True, True
    lake, pond = groups_beyond_chance(measured(failed))
    assert 54 <= len(lake) < 60
    assert 12 <= len(pond) < 16
    assert np.abs(np.median(lake, axis=0) - (5.5, 9.0)).max() <= 0.5


def test_the_place_of_the_largest_group_is_on_its_ground():
    """East and south of the north-western corner of the mosaic."""
    failed = np.zeros((30, 40), bool)
    failed[3:8, 10:17], failed[20:23, 30:34] = True, True
    grid = MosaicGrid(0.5, first_row=-640, first_col=1280, width=2560, height=1920)
    found, side_m = disagreement(measured(failed), grid), 0.5 * SQUARE_PX
    assert found.at_m == pytest.approx((640 + 13.5 * side_m, 320 - 5.5 * side_m))
    assert found.share == pytest.approx((35 + 12) / 1200)
    assert disagreement(measured(np.zeros((30, 40), bool)), grid) == Disagreement()


def test_a_small_map_without_a_failure_has_none():
    assert groups_beyond_chance(measured(np.zeros((2, 3), bool))) == []
    assert groups_beyond_chance(measured(np.zeros((0, 0), bool))) == []
