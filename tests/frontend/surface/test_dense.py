"""Heights of a tile by several pairs: which are believed, and how accurate they are."""

import numpy as np
import pytest

from frontend.mosaic.view import Lattice, mosaic_view
from frontend.surface.dense import _agreed, dense_heights
from frontend.surface.stereo import Placed
from tests.frontend.mosaic.scene import FLOOR_Z_M, photograph, pose, smooth_floor
from tests.frontend.surface.raised_plane import CAMERA, HEIGHT_M


def test_a_pair_alone_must_continue_the_heights_around_it():
    layers = np.full((2, 20, 20), np.nan, np.float32)
    layers[:, :, 8:] = 1.0
    layers[0, :, :8], layers[0, :10, :4] = 1.02, -3.0  # a pair alone, that is wrong beside its border
    in_view = np.isfinite(layers)
    in_view[:, :, :8] = False
    needed = np.where(np.isfinite(layers).all(axis=0), 2, 1)
    unit_m = np.array([0.1, 0.1])
    nothing = np.full(layers.shape[1:], np.nan, np.float32)
    found = _agreed(layers, in_view, unit_m, 0.1, needed, nothing)
    assert np.isnan(found.height_m[:10, :4]).all()
    assert found.height_m[10:] == pytest.approx(1.0, abs=0.03)
    assert found.height_m[:10, 4:] == pytest.approx(1.0, abs=0.03)
    in_whole_view = _agreed(layers, np.isfinite(layers), unit_m, 0.1, needed, nothing)
    assert np.isnan(in_whole_view.height_m[:10, :4]).all(), "no second pair checks them"
    assert np.array_equal(np.isfinite(in_whole_view.std_m), np.isfinite(in_whole_view.height_m))
    alone = layers[:1], np.isfinite(layers[:1]), unit_m[:1], 0.1, needed
    assert (_agreed(*alone, nothing).height_m[:10, :4] == -3.0).all()
    before = nothing.copy()
    before[-1] = 1.0
    beside = _agreed(*alone, before).height_m
    assert np.isnan(beside[:10, :4]).all(), "a height by one pair continues those that were known before"
    assert np.isfinite(beside[10:-1, :8]).all()


def test_heights_whose_range_is_not_in_view_do_not_lead_away_from_the_sure_ones():
    """Two pairs whose pictures end here are wrong in the same way: more and more, farther and farther out."""
    layers = np.ones((2, 20, 40), np.float32)
    layers[:, :, :20] = 1.0 - 0.15 * np.arange(20, 0, -1, dtype=np.float32)
    beside = np.ones(layers.shape, bool)
    beside[:, :, :20] = False
    needed, unknown = np.full((20, 40), 2), np.full((20, 40), np.nan, np.float32)
    found = _agreed(layers, beside, np.array([0.1, 0.1]), 0.1, needed, unknown).height_m
    assert np.nanmin(found) >= 0.8
    in_view = _agreed(
        layers, np.ones(layers.shape, bool), np.array([0.1, 0.1]), 0.1, needed, unknown
    ).height_m
    assert np.array_equal(in_view, layers[0])


def test_the_deviation_of_a_height_follows_from_the_bases_of_its_pairs():
    rng = np.random.default_rng(0)
    unit_m = np.array([0.1, 0.2, 0.1])
    layers = (0.3 * unit_m[:, None, None] * rng.normal(size=(3, 80, 80))).astype(np.float32)
    layers[1:, :, :40] = np.nan
    seen = np.isfinite(layers)
    nothing = np.full((80, 80), np.nan, np.float32)
    found = _agreed(layers, seen, unit_m, 0.5, np.where(seen[1], 2, 1), nothing)
    alone = found.std_m[:, :40]
    assert alone == pytest.approx(0.03, rel=0.1)
    assert np.std(found.height_m[:, :40]) == pytest.approx(alone.mean(), rel=0.1)
    assert (found.std_m[:, 40:] > 0.03).all(), "no height is certain because two pairs agree by chance"
    two = _agreed(
        layers[:2, :, :40], seen[:2, :, :40], unit_m[:2], 0.5, np.ones((80, 40), int), nothing[:, :40]
    )
    assert two.std_m == pytest.approx(0.1 / 3), "nothing tells the deviation of disparities"


def test_holes_are_searched_by_pictures_from_nearer_directions():
    """Three pictures a twentieth of their height apart are too near for the first search."""
    poses = [pose(0.11 * k, 0.0, 2.0, 0.1 * k) for k in range(3)]
    floor = smooth_floor(0, 640, 0.006, 1.0)
    shown = [photograph(floor, CAMERA, w_T_b, oversample=1).mean(axis=2).astype(np.uint8) for w_T_b in poses]
    views = [mosaic_view(CAMERA, k, w_T_b, FLOOR_Z_M - HEIGHT_M) for k, w_T_b in enumerate(poses)]
    lattice = Lattice(-0.3, 0.3, 0.02, 30, 30)
    found = dense_heights(
        views, lambda view, nodes: np.ones((nodes.rows, nodes.cols), bool),
        lambda view: Placed(CAMERA, view, shown[view.k]), lattice, 0.01,
    )  # fmt: skip
    assert np.isfinite(found.height_m).mean() > 0.8
    assert np.nanmedian(np.abs(found.height_m - HEIGHT_M)) < 0.03
