"""Extent of a mosaic: what the far ground of tilted pictures may cost the others."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX, grid_over
from frontend.mosaic.extent import MAX_ENLARGED, offered_extents, share_within, union
from frontend.mosaic.plan import TOO_FAR, MosaicPlan, plan_mosaic
from frontend.mosaic.view import MAX_OFF_NADIR, MosaicView, clipped, mosaic_view
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, pose, survey

SEEDS = range(8)
LONG = Camera((800.0, 800.0), (99.5, 74.5), (200, 150))
"""A long lens: 14 degrees by 11."""


def tilted(rng: np.random.Generator, least_deg: float = 45.0, most_deg: float = 59.0) -> np.ndarray:
    """A pose over the survey whose axis is far from straight down."""
    x, y = rng.uniform(-1, 1, 2)
    return pose(x, y, rng.uniform(1.8, 2.2), rng.uniform(-3, 3), np.radians(rng.uniform(least_deg, most_deg)))


def seen(poses: np.ndarray, camera: Camera = CAMERA) -> list[MosaicView]:
    views = [mosaic_view(camera, k, T, FLOOR_Z_M) for k, T in enumerate(poses)]
    return [view for view in views if isinstance(view, MosaicView)]


def planned(poses: np.ndarray, max_pixels: int) -> MosaicPlan:
    return plan_mosaic(CAMERA, poses, FLOOR_Z_M, max_pixels=max_pixels)


@pytest.mark.parametrize("seed", SEEDS)
def test_pictures_that_look_down_keep_all_ground_from_any_height(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = np.concatenate([survey(seed), [pose(*rng.uniform(-3, 3, 2), h) for h in (1.0, 6.0, 20.0)]])
    views = seen(poses)
    assert len(offered_extents(views, 0.01)) == 1
    for max_pixels in (10_000_000, 30_000):
        _, extent, _ = grid_over(views, None, max_pixels)
        np.testing.assert_array_equal(extent, union(np.array([view.bounds_m for view in views])))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tilted_picture_hardly_coarsens_the_mosaic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    down = survey(seed, 6, 8)
    alone = planned(down, 10_000_000)
    for poses in (np.concatenate([down, [tilted(rng)]]), np.concatenate([[tilted(rng)], down])):
        both = planned(poses, alone.width * alone.height)
        assert both.gsd_m <= 1.11 * alone.gsd_m
        assert len(both.beyond) == 1
        assert not both.left_out
        whole = planned(poses, 100_000_000)
        assert whole.gsd_m == alone.gsd_m
        assert not whole.beyond


@pytest.mark.parametrize("yaw", np.linspace(0.1, 6.1, 7))
def test_ground_of_a_tilted_picture_near_the_survey_is_drawn(yaw: float) -> None:
    down, height_m = survey(9, 6, 8), 2.0
    outward = np.array([np.cos(yaw), np.sin(yaw)])
    x, y = 2.0 * outward
    # A pitch upwards looks ahead.
    poses = np.concatenate([down, [pose(x, y, height_m, yaw, np.radians(-50))]])
    alone, whole = (planned(each, 100_000_000) for each in (down, poses))
    budget = alone.width * alone.height
    both = planned(poses, budget)
    assert both.beyond[len(down)] > 0.2
    largest = np.sqrt(whole.width * whole.height / budget) * whole.gsd_m
    assert both.gsd_m < min(1.11 * alone.gsd_m, largest)
    for away in np.linspace(0.7, 1.2, 6):
        east, north = np.array([x, y]) + away * height_m * outward
        column, row = (east - both.west_m) / both.gsd_m, (both.north_m - north) / both.gsd_m
        assert both.owner[int(row) // CELL_PX, int(column) // CELL_PX] >= 0


@pytest.mark.parametrize("seed", SEEDS)
def test_pixels_are_those_of_pictures_that_look_down_though_most_are_tilted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    down = survey(seed)
    poses = np.concatenate([down, [tilted(rng) for _ in range(4 * len(down))]])
    assert planned(poses, 100_000_000).gsd_m == planned(down, 100_000_000).gsd_m


@pytest.mark.parametrize("seed", SEEDS)
def test_each_extent_lies_in_the_one_before_and_holds_the_ground_that_counts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gsd_m = rng.uniform(0.005, 0.04)
    poses = np.concatenate([survey(seed), [tilted(rng) for _ in range(5)]])
    views = seen(poses)
    extents = np.array(offered_extents(views, gsd_m))
    assert (np.diff(extents[:, :2], axis=0) >= 0).all()
    assert (np.diff(extents[:, 2:], axis=0) <= 0).all()
    pixel = rng.uniform(0, np.array(CAMERA.size_px) - 1, (1000, 2))
    for view in views:
        p, right, down = (
            CAMERA.floor_points(poses[view.k], pixel + d, FLOOR_Z_M) for d in ((0, 0), (1e-3, 0), (0, 1e-3))
        )
        sides_m = np.stack([right - p, down - p], axis=1) / 1e-3
        resolved_m = np.sqrt(np.abs(np.linalg.det(sides_m)))
        near = np.linalg.norm(p - view.w_p_c_m[:2], axis=1) < view.height_m * np.tan(MAX_OFF_NADIR)
        counts = near & (resolved_m < max(gsd_m, MAX_ENLARGED * view.nadir_gsd_m))
        assert counts.sum() > 100
        # The outline has straight sides where the ground used ends in a circle.
        assert (p[counts] > extents[-1, :2] - 0.02).all()
        assert (p[counts] < extents[-1, 2:] + 0.02).all()


def test_a_picture_without_any_ground_that_counts_is_left_out_with_the_reason() -> None:
    poses = np.array([pose(0.2 * x, 0, 2) for x in range(8)] + [pose(0, 0, 2, 0, np.radians(59))])
    plan = plan_mosaic(LONG, poses, FLOOR_Z_M, max_pixels=160_000)
    assert plan.left_out == {8: f"all ground that it shows is {TOO_FAR}"}
    assert plan.beyond == {8: 1.0}
    assert plan.gsd_m == plan_mosaic(LONG, poses[:8], FLOOR_Z_M).gsd_m
    assert not plan_mosaic(LONG, poses, FLOOR_Z_M).left_out


def test_tilted_pictures_alone_make_a_mosaic_of_what_they_resolve_best() -> None:
    poses = np.array([pose(0, 0, 2, yaw, np.radians(55)) for yaw in np.linspace(0, 6, 8)])
    whole, near = planned(poses, 10_000_000), planned(poses, 100_000)
    assert set(near.beyond) == set(range(8))
    assert near.width * near.height <= 100_000
    assert near.gsd_m < np.sqrt(whole.width * whole.height / 100_000) * whole.gsd_m / 1.3
    # Only far ground: no picture has it all.
    far = plan_mosaic(LONG, np.array([pose(0, 0, 2, 0, np.radians(59))]), FLOOR_Z_M, max_pixels=2000)
    assert not far.left_out
    assert far.width * far.height <= 2000


def test_a_plan_over_the_ground_of_another_has_its_grid() -> None:
    rng = np.random.default_rng(5)
    poses = np.concatenate([survey(5), [tilted(rng)]])
    plan = planned(poses, 250_000)
    assert plan.beyond
    again = plan_mosaic(CAMERA, poses, FLOOR_Z_M, plan.gsd_m, leave_out=plan.left_out, bounds_m=plan.bounds_m)
    for name in ("first_row", "first_col", "width", "height"):
        assert getattr(again, name) == getattr(plan, name)
    np.testing.assert_array_equal(again.owner, plan.owner)
    assert {view.k for view in plan.all_views(poses)} == set(range(len(poses)))


def test_share_within_bounds_is_that_of_points_of_the_floor() -> None:
    rng = np.random.default_rng(3)
    for T in (tilted(rng), pose(0.2, -0.3, 2.0, 0.7, 0.3, -0.2)):
        (view,) = seen(T[None])
        west, south, east, north = view.bounds_m
        half = np.array([west, south, (west + east) / 2, north])
        parts = [half, np.array([(west + east) / 2, south, east, north])]
        assert sum(share_within(view, part) for part in parts) == pytest.approx(1.0)
        assert share_within(view, view.bounds_m) == pytest.approx(1.0)
        assert share_within(view, view.bounds_m + 100.0) == 0.0


def test_a_line_cuts_a_polygon_into_two_that_fill_it() -> None:
    square = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])
    line = np.array([1.0, 2.0, -3.0])
    np.testing.assert_allclose(clipped(square, line), [(3, 0), (4, 0), (4, 4), (0, 4), (0, 1.5)])
    np.testing.assert_allclose(clipped(square, -line), [(0, 0), (3, 0), (0, 1.5)])
    assert clipped(square, np.array([1.0, 0.0, 0.0])) is square
    assert len(clipped(square, np.array([1.0, 0.0, -5.0]))) == 0
