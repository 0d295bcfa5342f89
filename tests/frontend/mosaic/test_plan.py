"""Plan of a mosaic: grid, choice of pictures and owners."""

from __future__ import annotations

import dataclasses
import time

import cv2
import numpy as np
import pytest

from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX, MosaicError
from frontend.mosaic.plan import SUFFICIENT_RATIO, MosaicPlan, plan_mosaic
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, pixel_maps, visible
from tests.frontend.mosaic.scene import CAMERA, FLOOR_Z_M, over_depth, pose, survey

WIDE = Camera((90.0, 95.0), (101.0, 73.0), (200, 150), (-0.2, 0.05, 0.003, -0.002))


def hover(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [
            pose(*rng.normal(0, 0.03, 2), 2 + rng.normal(0, 0.03), *rng.normal(0, 0.02, 3))
            for _ in range(count)
        ]
    )


@pytest.mark.parametrize("camera", [CAMERA, WIDE])
def test_pixel_maps_agree_with_projecting_the_floor_point_by_point(camera: Camera) -> None:
    T = pose(0.3, -0.2, 1.7, 0.8, 0.25, -0.3)
    view = mosaic_view(camera, 0, T, FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    lattice = Lattice(-0.4, 0.5, 0.07, 20, 15)
    u, v = pixel_maps(camera, view, lattice)
    r, c = np.mgrid[:20, :15]
    w_p = np.column_stack(
        [lattice.x0_m + 0.07 * c.ravel(), lattice.y0_m - 0.07 * r.ravel(), np.full(300, FLOOR_Z_M)]
    )
    w_T_c = T @ camera.b_T_c
    pixel = camera.project((w_p - w_T_c[:3, 3]) @ w_T_c[:3, :3])
    np.testing.assert_allclose(np.column_stack([u.ravel(), v.ravel()]), pixel, atol=2e-3)


def test_ground_sample_distance_is_that_of_two_neighbouring_pixels() -> None:
    T = pose(0, 0, 3.0, 0.3, 0.4, 0.1)
    view = mosaic_view(CAMERA, 0, T, FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    middle = np.array(CAMERA.center_px)
    p, right, down = CAMERA.floor_points(T, middle + [[0, 0], [1e-3, 0], [0, 1e-3]], FLOOR_Z_M)
    area = abs(np.linalg.det(np.array([right - p, down - p]) / 1e-3))
    assert view.gsd_m == pytest.approx(np.sqrt(area), rel=1e-3)


def test_unusable_poses_are_counted_with_their_reason() -> None:
    poses = np.array(
        [
            pose(0, 0, 2),
            np.full((4, 4), np.nan),
            pose(0, 0, -1),
            pose(0, 0, 2, 0, 2.0),
            pose(500, 0, 2),
            pose(0.5, 0, 2, 0, 0.6),
        ]
    )
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M, leave_out={5: "blurred"})
    assert plan.left_out == {
        1: "not placed",
        2: "camera below the floor",
        3: "looks towards the horizon",
        4: "lies far from the rest",
        5: "blurred",
    }
    assert [v.k for v in plan.views] == [0]
    assert plan.width * plan.height < 1.1 * 200 * 150


def test_no_usable_picture_is_an_error_with_the_reason() -> None:
    with pytest.raises(MosaicError, match="camera below the floor"):
        plan_mosaic(CAMERA, np.array([pose(0, 0, -1)]))
    with pytest.raises(MosaicError, match="there are none"):
        plan_mosaic(CAMERA, np.zeros((0, 4, 4)))


@pytest.mark.parametrize("pitch", [1.1, 1.2, 1.3, 1.4])
def test_a_picture_is_drawn_as_far_as_its_ground_is_near_wherever_it_points(pitch: float) -> None:
    """Its axis may point beyond the ground that is drawn: the pixel stays that of the near part."""
    view = mosaic_view(WIDE, 0, pose(0, 0, 2, 0, pitch), FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    reach_m = 2 * np.tan(np.radians(70))
    assert np.linalg.norm(view.outline_m, axis=1).max() == pytest.approx(reach_m)
    assert view.gsd_m <= view.nadir_gsd_m * np.cos(np.radians(70)) ** -1.5 * (1 + 1e-9)


def test_picture_that_sees_the_horizon_keeps_its_near_part() -> None:
    plan = plan_mosaic(WIDE, np.array([pose(0, 0, 2, 0, 0.8)]), FLOOR_Z_M)
    assert plan.views[0].bounds_m[0] >= -2 * np.tan(np.radians(70)) - 1e-9
    assert (plan.owner >= 0).any()


def test_two_distant_groups_that_fill_their_canvas_are_both_kept() -> None:
    poses = np.array([pose(x, 0, 2) for x in (0, 0.5, 1, 9, 9.5, 10)])
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    assert not plan.left_out


def test_canvas_holds_every_footprint_and_lies_on_whole_pixels() -> None:
    poses = survey(1)
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=0.013)
    corners = np.concatenate([CAMERA.footprint(T, FLOOR_Z_M) for T in poses])
    low = np.array([plan.west_m, plan.north_m - plan.height * plan.gsd_m])
    high = np.array([plan.west_m + plan.width * plan.gsd_m, plan.north_m])
    assert (corners.min(axis=0) >= low - 1e-9).all()
    assert (corners.max(axis=0) <= high + 1e-9).all()
    # Whole cells to the west and north, whole pixels to the south and east.
    spare = np.array([corners[:, 0].min() - low[0], high[1] - corners[:, 1].max()])
    assert (spare < CELL_PX * plan.gsd_m + 1e-9).all()
    spare = np.array([high[0] - corners[:, 0].max(), corners[:, 1].min() - low[1]])
    assert (spare < plan.gsd_m + 1e-9).all()
    assert plan.first_row % CELL_PX == plan.first_col % CELL_PX == 0


def test_a_canvas_that_grows_keeps_its_tiles_and_points() -> None:
    poses = survey(1)
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=0.013)
    grown = plan_mosaic(CAMERA, np.concatenate([poses, [pose(-4.1, 3.3, 2)]]), FLOOR_Z_M, gsd_m=0.013)
    assert grown.first_row < plan.first_row
    assert grown.first_col < plan.first_col

    def places(plan: MosaicPlan) -> set[tuple[int, ...]]:
        return {
            (plan.first_row + t.row, plan.first_col + t.col, t.rows, t.cols)
            for t in dataclasses.replace(plan, tile_px=64).tiles
            if min(t.row, t.col) > 0
        }

    kept = places(plan) & places(grown)
    assert len(kept) > 0.6 * len(places(plan))
    assert sum(rows * cols for *_, rows, cols in places(plan)) < plan.width * plan.height
    assert plan.sampling.pitch_px == grown.sampling.pitch_px
    for each in (plan, grown):
        squares, pitch = each.sampling, each.sampling.pitch_px
        assert (each.first_row + squares.row) % pitch == (each.first_col + squares.col) % pitch == 0
    # The same pixel has the same place, to the last bit.
    down, right = plan.first_row - grown.first_row, plan.first_col - grown.first_col
    assert plan.lattice(7, 9, 2, 2) == grown.lattice(7 + down, 9 + right, 2, 2)


def test_default_resolution_is_stable_for_one_more_picture() -> None:
    few = {plan_mosaic(CAMERA, survey(seed), FLOOR_Z_M).gsd_m for seed in range(12)}
    assert len(few) <= 4
    assert all(gsd_m == float(f"{gsd_m:.1e}") for gsd_m in few)


def test_default_resolution_respects_the_pixel_budget_and_notes_it() -> None:
    poses = survey(2)
    free = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    assert free.note == ""
    assert free.gsd_m == pytest.approx(0.01, rel=0.1)
    for budget in (60_000, 20_000, 8_000):
        tight = plan_mosaic(CAMERA, poses, FLOOR_Z_M, max_pixels=budget)
        assert 0.5 * budget < tight.width * tight.height <= budget
        assert f"{tight.gsd_m:.3g} m/pixel" in tight.note
    with pytest.raises(MosaicError, match="coarser"):
        plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=1e-6)


def test_hovering_needs_few_pictures_and_little_time() -> None:
    began = time.process_time()
    many = plan_mosaic(CAMERA, hover(3, 1000), FLOOR_Z_M, gsd_m=0.003)
    assert time.process_time() - began < 10
    few = plan_mosaic(CAMERA, hover(3, 100), FLOOR_Z_M, gsd_m=0.003)
    assert len(few.views) <= len(many.views) <= 16
    assert len(many.views) + many.redundant == 1000


def test_no_gap_remains_between_two_pictures_where_a_third_sees_it() -> None:
    # At 2 m 1.5 m are seen along x: 5 cm between the outer two; the third shows nothing else that is new.
    poses = np.array([pose(-0.77, 0, 2), pose(0.78, 0, 2), pose(0, 0, 2)])
    for gsd_m in (0.01, 0.003):
        plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=gsd_m)
        assert {v.k for v in plan.views} == {0, 1, 2}
        middle = round((0.005 - plan.west_m) / gsd_m) // CELL_PX
        assert plan.views[plan.owner[plan.owner.shape[0] // 2, middle]].k == 2


def test_picture_is_kept_for_a_rim_that_no_other_sees() -> None:
    # The camera sees 2 x 1.5 m; the second picture adds 8 mm (a cell) at one side, else is as good.
    both = plan_mosaic(CAMERA, np.array([pose(0, 0, 2), pose(0, 0.008, 2)]), FLOOR_Z_M, gsd_m=0.0005)
    assert len(both.views) == 2
    same = plan_mosaic(CAMERA, np.array([pose(0, 0, 2), pose(0, 0, 2)]), FLOOR_Z_M)
    assert len(same.views) == 1


def test_kept_pictures_see_all_ground_nearly_as_well_as_all_pictures_together() -> None:
    poses = np.concatenate([hover(4, 60), survey(5)])
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    step = CELL_PX * plan.gsd_m
    rows, cols = plan.owner.shape
    x, y = np.meshgrid(
        plan.west_m + (np.arange(cols) + 0.5) * step, plan.north_m - (np.arange(rows) + 0.5) * step
    )
    w_p = np.stack([x.ravel(), y.ravel(), np.full(x.size, FLOOR_Z_M)], axis=1)

    def quality(T: np.ndarray) -> np.ndarray:
        w_T_c = T @ CAMERA.b_T_c
        uv = CAMERA.project((w_p - w_T_c[:3, 3]) @ w_T_c[:3, :3])
        border = np.minimum(uv, np.array(CAMERA.size_px) - 1 - uv).min(axis=1)
        return np.nan_to_num(border, nan=-1)

    everyone = np.array([quality(T) for T in poses])
    chosen = np.array([quality(poses[v.k]) for v in plan.views])
    owned = plan.owner.ravel() >= 0
    assert (owned | (everyone.max(axis=0) < 0)).all()
    own = chosen[plan.owner.ravel()[owned], np.flatnonzero(owned)]
    best = everyone.max(axis=0)[owned]
    assert (own[best > 20] > 0).all()
    # Distance to the border is one of three parts of the quality, so the bound holds for most cells only.
    assert (own[best > 20] >= 0.5 * SUFFICIENT_RATIO * best[best > 20]).mean() > 0.95


def test_owners_do_not_depend_on_pictures_elsewhere() -> None:
    poses = survey(6)
    alone = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=0.01)
    far = np.concatenate([poses, [pose(6.5, 0, 2.0)]])
    both = plan_mosaic(CAMERA, far, FLOOR_Z_M, gsd_m=0.01)
    assert both.width > alone.width
    kept = {v.k for v in alone.views}
    assert kept | {len(poses)} == {v.k for v in both.views}


def test_bounds_contain_the_footprint_of_a_distorted_lens() -> None:
    T = pose(0, 0, 2.0, 0.4, 0.1, 0.1)
    view = mosaic_view(WIDE, 0, T, FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    t = np.linspace(0, 1, 200)
    edge = np.concatenate([np.column_stack([t * 199, np.full(200, b)]) for b in (0, 149)])
    ideal = cv2.undistortPoints(edge[:, None], WIDE.matrix, np.array(WIDE.distortion), P=WIDE.matrix)
    floor = WIDE.floor_points(T, ideal.reshape(-1, 2), FLOOR_Z_M)
    assert (floor > view.bounds_m[:2] - 0.02).all()
    assert (floor < view.bounds_m[2:] + 0.02).all()


def test_raised_ground_is_seen_as_a_floor_at_its_height_is() -> None:
    T, lattice = pose(0.3, -0.2, 1.7, 0.8, 0.25, -0.3), Lattice(-3.0, 3.0, 0.1, 60, 60)
    for height_m in (-0.8, 0.6):
        raised = visible(mosaic_view(WIDE, 0, T, FLOOR_Z_M), lattice, np.full((60, 60), height_m, np.float32))
        floor = visible(mosaic_view(WIDE, 0, T, FLOOR_Z_M + height_m), lattice)
        assert 0 < raised[0].sum() < 3600
        for one, other in zip(raised, floor, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("depth_m", [0.4, 2.0])
def test_ground_beyond_a_surface_is_as_high_as_at_its_border(depth_m: float) -> None:
    flat = plan_mosaic(CAMERA, poses := hover(0, 3), FLOOR_Z_M)
    np.testing.assert_array_equal(over_depth(flat, poses, depth_m).owner >= 0, flat.owner >= 0)


def test_the_grid_of_the_exposure_is_made_once() -> None:
    sampling = (plan := plan_mosaic(CAMERA, hover(0, 3), FLOOR_Z_M)).sampling
    assert plan.sampling is sampling, "each picture asks for it, and it depends on all pictures"
