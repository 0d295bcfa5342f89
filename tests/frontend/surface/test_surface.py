"""The surface of the ground: pictures of a plane at a known height, and the ground that a box hides."""

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from frontend.elevation import Elevation
from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.surface import HeightSource, Surface
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, raised_maps
from frontend.surface.build import build_surface
from frontend.surface.dense import _agreed, dense_heights
from frontend.surface.holes import filled, without_specks
from frontend.surface.misregistration import (
    SQUARE_PX,
    Misregistration,
    measure_misregistration,
    seen_by_two,
)
from frontend.surface.relief import relief_squares, relief_threshold_px
from frontend.surface.stereo import Placed, ground_points, rectified
from frontend.workers import Workers, share_with
from slam.core.progress import silent
from slam.report.rasters.surface import measure_ground, without_unseen
from tests.frontend.mosaic.scene import FLOOR_Z_M, photograph, pose, smooth_floor
from tests.frontend.sent_workers import SentWorkers

HEIGHT_M = 0.2
"""True height of the ground over the floor that the map assumes."""
GSD_M = 0.00625
CAMERA = Camera((320.0, 320.0), (159.5, 119.5), (320, 240), (-0.05, 0.02, 0.001, -0.001))
POSES = np.array([pose(0.3 * (k % 3) - 0.3, 0.35 * (k // 3), 2.0, 0.1 * k, 0.02, -0.03) for k in range(6)])


@pytest.fixture(scope="module")
def pictures():
    return [photograph(smooth_floor(0, 640, 0.006, 1.0), CAMERA, w_T_b, oversample=1) for w_T_b in POSES]


def measured(pictures, poses, floor_z_m, surface=None):
    plan = plan_mosaic(CAMERA, poses, floor_z_m, GSD_M, surface=surface)
    return plan, measure_misregistration(plan, Pictures(plan, lambda k: pictures[k]))


def test_pictures_of_a_flat_floor_agree_and_show_no_relief(pictures):
    _, found = measured(pictures, POSES, FLOOR_Z_M)
    assert len(found.square) > 4
    assert found.found.all()
    assert found.percentile_px(95) < 0.5
    assert not relief_squares(found).any()


def test_a_displaced_picture_is_misregistered_by_its_displacement(pictures):
    moved = POSES.copy()
    moved[1::2, 0, 3] += 6 * GSD_M
    _, found = measured(pictures, moved, FLOOR_Z_M)
    size = np.linalg.norm(found.shift_px[found.found], axis=1)
    # Two pictures of one square have moved by the same 6 px, or one of them has.
    assert np.all((size < 0.5) | (np.abs(size - 6) < 0.5))
    assert np.any(size > 5)


def test_ground_at_another_height_displaces_along_the_parallax_alone(pictures):
    _, found = measured(pictures, POSES, FLOOR_Z_M - HEIGHT_M)
    assert np.abs(found.across_px[found.found]).max() < 0.5
    along, parallax = found.along_px[found.found], np.linalg.norm(found.parallax_px_m[found.found], axis=1)
    # Exactly h / (H - h) instead of h / H: the camera is 2.2 m over the assumed floor.
    assert along / parallax == pytest.approx(HEIGHT_M / (1 - HEIGHT_M / (2 + HEIGHT_M)), abs=0.02)


def shifts(along_px, across_px):
    n = len(along_px)
    square = np.column_stack([np.arange(n) // 20, np.arange(n) % 20])
    parallax = np.tile([10.0, 0.0], (n, 1))
    return Misregistration((n // 20, 20), square, np.column_stack([along_px, across_px]), parallax)


def test_the_threshold_holds_its_false_discovery_rate():
    """On flat ground hardly ever a square is taken for relief; where there is some, most of it is found."""
    rng = np.random.default_rng(0)
    flat = [shifts(*rng.standard_t(3, (2, 400))) for _ in range(100)]
    assert np.mean([relief_squares(case).any() for case in flat]) < 0.1
    shares, missed = [], []
    for _ in range(50):
        along, across = rng.standard_t(3, (2, 400))
        along[:100] += rng.choice([-1, 1], 100) * rng.uniform(5, 20, 100)
        taken = relief_squares(shifts(along, across)).ravel()
        shares.append(taken[100:].sum() / max(taken.sum(), 1))
        missed.append(1 - taken[:100].mean())
    assert 0.005 < np.mean(shares) < 0.05
    assert np.mean(missed) < 0.3
    assert relief_threshold_px(shifts(0.1 * along, 0.01 * across)) >= 0.5  # what nobody sees does not count


def test_two_pictures_give_the_height_of_the_ground(pictures):
    lattice = Lattice(-0.3, 0.3, 0.02, 30, 30)
    views = [mosaic_view(CAMERA, k, POSES[k], FLOOR_Z_M - HEIGHT_M) for k in (0, 2)]
    a, b = (Placed(CAMERA, view, pictures[view.k].mean(axis=2).astype(np.uint8)) for view in views)
    points = ground_points(a, b, rectified(a, b, lattice, (0.1, 0.3), 0.01)).w_p_m
    over = (np.abs(points[:, :2]) < 0.3).all(axis=1)
    assert over.sum() > 1000
    assert np.median(points[over, 2]) == pytest.approx(HEIGHT_M, abs=0.01)
    assert np.percentile(np.abs(points[over, 2] - HEIGHT_M), 90) < 0.03


def test_beside_the_border_of_a_picture_a_match_may_be_wrong(pictures):
    """The search goes far below the ground: where the second picture does not show it, the first matches
    something else."""
    lattice = Lattice(-0.8, 0.8, 0.02, 80, 80)
    views = [mosaic_view(CAMERA, k, POSES[k], FLOOR_Z_M - HEIGHT_M) for k in (0, 2)]
    a, b = (Placed(CAMERA, view, pictures[view.k].mean(axis=2).astype(np.uint8)) for view in views)
    points = ground_points(a, b, rectified(a, b, lattice, (-0.6, 0.5), 0.01))
    wrong = np.abs(points.w_p_m[:, 2] - HEIGHT_M) > 0.05
    assert 0.3 < points.range_in_view.mean() < 0.95
    assert wrong[points.range_in_view].mean() < 0.01 < wrong[~points.range_in_view].mean()


def test_a_lens_whose_polynomial_turns_back_shows_no_ground_beside_the_picture():
    """At 1.2 times the focal length off the axis, these coefficients lead back to the middle."""
    camera = replace(CAMERA, distortion=(-0.42, 0.33, 0.0, 0.0, -0.28))
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 255, (240, 320), dtype=np.uint8)
    views = [mosaic_view(camera, k, POSES[k], FLOOR_Z_M) for k in (0, 1)]
    a, b = (Placed(camera, view, grey) for view in views)
    east_m, south_m = views[0].bounds_m[2] + 0.3, views[0].bounds_m[1]
    beside = Lattice(east_m, south_m + 1.0, 0.02, 50, 100)
    over = rectified(a, b, beside, (-0.2, 0.5), GSD_M)
    assert over is not None
    assert len(ground_points(a, b, over).w_p_m) == 0


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


@pytest.mark.parametrize(
    ("along_m", "climb_m", "fits"), [(0.4, 0.0, True), (0.4, 0.1, True), (0.1, 0.6, False), (0.0, 0.5, False)]
)
def test_pictures_of_a_climb_are_not_turned_to_the_horizon(along_m, climb_m, fits):
    """Rows along a steep base would look past the ground: gigabytes of it, for no height."""
    lattice = Lattice(-0.8, 0.8, 0.02, 80, 80)
    poses = [pose(0.0, 0.0, 2.0, 0.0, 0.0, 0.0), pose(along_m, 0.0, 2.0 + climb_m, 0.0, 0.0, 0.0)]
    grey = np.zeros((CAMERA.size_px[1], CAMERA.size_px[0]), np.uint8)
    a, b = (Placed(CAMERA, mosaic_view(CAMERA, k, pose, 0.0), grey) for k, pose in enumerate(poses))
    over = rectified(a, b, lattice, (-0.2, 0.5), 0.01)
    assert (over is not None) is fits
    assert over is None or over.rows * over.cols < 4e5


def test_over_the_measured_surface_pictures_agree(pictures):
    floor_z_m = FLOOR_Z_M - HEIGHT_M
    plan, before = measured(pictures, POSES, floor_z_m)
    everywhere = np.ones(before.shape, bool)
    surface = build_surface(plan, Pictures(plan, lambda k: pictures[k]), everywhere, None)
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
    surface = build_surface(plan, Pictures(plan, lambda k: pictures[k]), everywhere, None)
    assert surface.height_m.size <= 20_000 < plan.width * plan.height / 4
    assert surface.cell_m == pytest.approx(4 * GSD_M)
    known = surface.source == HeightSource.PICTURES
    assert np.median(np.abs(surface.height_m[known] - HEIGHT_M)) < 0.02, "cells of twice the side"


def boxed(height_m=0.5):
    heights = np.zeros((60, 60), np.float32)
    heights[20:35, 25:40] = height_m
    source = np.where(heights > 0, HeightSource.PICTURES, HeightSource.FLOOR).astype(np.uint8)
    return Surface(-0.6, 0.6, 0.02, heights, np.zeros_like(heights), source)


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


def test_ground_behind_a_box_is_hidden():
    """Against rays in small steps; cells within two of the outline of the shadow may differ."""
    surface, camera = boxed(), Camera((300.0, 300.0), (149.5, 149.5), (300, 300))
    view = mosaic_view(camera, 0, pose(-0.7, -0.9, 1.5) - FLOOR_Z_M * np.eye(4)[:, 2:3] @ np.eye(4)[3:], 0.0)
    assert isinstance(view, MosaicView)
    lattice = Lattice(-0.59, 0.59, 0.02, 60, 60)
    hidden = surface.hidden(view, lattice)
    x, y = np.meshgrid(-0.59 + 0.02 * np.arange(60), 0.59 - 0.02 * np.arange(60))
    ground = np.stack([x, y, surface.height_m], axis=-1)
    camera_at = np.array([*view.w_p_c_m[:2], view.height_m])
    true = np.zeros_like(hidden)
    for share in np.linspace(0.001, 0.6, 600):
        at = ground + share * (camera_at - ground)
        c, r = (
            np.floor((at[..., 0] + 0.6) / 0.02).astype(int),
            np.floor((0.6 - at[..., 1]) / 0.02).astype(int),
        )
        on = (r >= 0) & (r < 60) & (c >= 0) & (c < 60)
        true[on] |= surface.height_m[r[on], c[on]] > at[..., 2][on] + 0.01
    assert 0.03 < true.mean() < 0.2
    assert np.mean(hidden != true) < 0.02
    assert not replace(surface, height_m=0 * surface.height_m).hidden(view, lattice).any()


def test_raised_ground_is_seen_where_the_lens_projects_it():
    view = mosaic_view(CAMERA, 0, POSES[3], FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    lattice = Lattice(-0.4, 0.4, 0.02, 40, 40)
    heights = np.random.default_rng(1).uniform(0, 0.5, (40, 40)).astype(np.float32)
    u, v = raised_maps(CAMERA, view, lattice, heights)
    x, y = np.meshgrid(-0.4 + 0.02 * np.arange(40), 0.4 - 0.02 * np.arange(40))
    w_p = np.stack([x, y, heights + FLOOR_Z_M, np.ones_like(x)], axis=-1).reshape(-1, 4)
    c_p = w_p @ np.linalg.inv(POSES[3] @ CAMERA.b_T_c).T
    pixel = CAMERA.project(c_p[:, :3])
    inside = ((pixel > 0) & (pixel < np.array(CAMERA.size_px) - 1)).all(axis=1)
    assert inside.sum() > 500
    assert np.abs(np.column_stack([u.ravel(), v.ravel()]) - pixel)[inside].max() < 0.03


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


def test_a_square_is_seen_by_two_where_two_pictures_contain_its_corners():
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, 0.01)
    seen = seen_by_two(plan)
    assert seen.any()
    assert not seen.all()
    for row, column in np.ndindex(*seen.shape):
        corners = np.array([(column + i, row + j) for i in (0, 1) for j in (0, 1)]) * SQUARE_PX * plan.gsd_m
        x_m, y_m = plan.west_m + corners[:, 0], plan.north_m - corners[:, 1]
        containing = 0
        for w_T_b in POSES:
            image_H_floor = np.linalg.inv(CAMERA.floor_H_image(w_T_b, FLOOR_Z_M))
            u, v, w = image_H_floor @ np.array([x_m, y_m, np.ones(4)])
            inside = (
                (u / w > 0) & (u / w < CAMERA.size_px[0] - 1) & (v / w > 0) & (v / w < CAMERA.size_px[1] - 1)
            )
            containing += bool(inside.all())
        assert containing >= 2 or not seen[row, column]


@pytest.mark.slow
def test_ground_that_the_mosaic_shows_once_is_measured_where_other_pictures_show_it(pictures):
    floor_z_m = FLOOR_Z_M - HEIGHT_M
    whole = plan_mosaic(CAMERA, POSES, floor_z_m, GSD_M / 2)  # enough squares for a decision
    fewer = replace(whole, views=whole.views[:4])
    load = pictures.__getitem__
    found = measure_ground(fewer, Pictures(fewer, load), load, np.array(POSES), floor_z_m, None, silent)
    compared = found.over_floor.compared
    assert (seen_by_two(whole) & ~compared).any()
    source = found.surface.source
    cells = SQUARE_PX * whole.gsd_m / found.surface.cell_m  # along a square
    for row, column in ((np.argwhere(seen_by_two(whole) & ~compared) + 0.5) * cells).astype(int):
        assert source[row, column] != HeightSource.FLOOR
