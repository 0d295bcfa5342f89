"""Rendered mosaics compared with the true floor."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

import frontend.mosaic.pictures as pictures_module
from frontend.camera import Camera
from frontend.mosaic.canvas import Tile
from frontend.mosaic.exposure import Exposure
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan, plan_mosaic
from frontend.mosaic.render import measure_exposure, render_tile, render_tiles
from tests.frontend.mosaic.scene import (
    CAMERA,
    FLOOR_Z_M,
    Floor,
    over_depth,
    photograph,
    pose,
    smooth_floor,
    survey,
)

LENS = dataclasses.replace(CAMERA, distortion=(-0.12, 0.03, 0.002, -0.001))


def whole(plan: MosaicPlan, pictures: Pictures, exposure: Exposure | None = None) -> np.ndarray:
    rgba = np.zeros((plan.height, plan.width, 4), np.uint8)
    for done in render_tiles(plan, pictures, exposure or Exposure.neutral(len(plan.views))):
        t = done.tile
        rgba[t.row : t.row + t.rows, t.col : t.col + t.cols] = done.rgba
    return rgba


def floor_under(plan: MosaicPlan, floor: Floor) -> np.ndarray:
    """(height, width, 3) RGB of the floor at the pixel centres."""
    x = plan.west_m + (np.arange(plan.width) + 0.5) * plan.gsd_m
    y = plan.north_m - (np.arange(plan.height) + 0.5) * plan.gsd_m
    return floor.at(*np.meshgrid(x, y))[..., ::-1]


def inner(rgba: np.ndarray, px: int = 3) -> np.ndarray:
    return cv2.erode(rgba[..., 3], np.ones((2 * px + 1, 2 * px + 1)), borderValue=0) > 0


@pytest.mark.parametrize(
    "camera", [pytest.param(CAMERA, marks=pytest.mark.slow, id="pinhole"), pytest.param(LENS, id="lens")]
)
def test_mosaic_of_noisy_pictures_is_the_floor_with_their_noise(camera: Camera) -> None:
    floor, poses, rng = smooth_floor(1), survey(2), np.random.default_rng(3)
    noise = 4.0
    views = [photograph(floor, camera, T).astype(float) for T in poses]
    views = [np.clip(np.rint(v + rng.normal(0, noise, v.shape)), 0, 255).astype(np.uint8) for v in views]
    plan = plan_mosaic(camera, poses, FLOOR_Z_M, gsd_m=0.01)
    rgba = whole(plan, Pictures(plan, views.__getitem__))
    error = (rgba[..., :3] - floor_under(plan, floor))[inner(rgba)]
    assert abs(error.mean()) < 0.2
    # One picture a pixel, interpolated: neither averaged over many (blur) nor above the noise put in.
    assert 0.6 * noise < error.std() < 1.05 * noise
    assert np.abs(error).max() < 7 * noise


def test_clean_pictures_give_the_floor_to_a_grey_level() -> None:
    floor, poses = smooth_floor(1), survey(4)
    views = [photograph(floor, CAMERA, T) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    assert plan.gsd_m == pytest.approx(0.01, rel=0.05)
    rgba = whole(plan, Pictures(plan, views.__getitem__))
    error = (rgba[..., :3] - floor_under(plan, floor))[inner(rgba)]
    assert error.std() < 1.5
    # One pixel off is seen by this test.
    moved = dataclasses.replace(plan, first_col=plan.first_col + 1)
    worse = (rgba[..., :3] - floor_under(moved, floor))[inner(rgba)]
    assert worse.std() > 2.5 * error.std()


@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
@pytest.mark.parametrize(
    "gsd_m", [0.01, *(pytest.param(gsd_m, marks=pytest.mark.slow) for gsd_m in (0.0173, 0.006))]
)
def test_landmark_lies_at_the_position_of_the_affine(camera: Camera, gsd_m: float) -> None:
    floor, spot = smooth_floor(5), np.array([0.337, -0.281])
    c, r = floor.texel(*spot)
    yy, xx = np.mgrid[:1000, :1000]
    # A Gaussian mark of 2.5 cm on grey, centred between texels.
    mark = 80 + 150 * np.exp(-((xx - c) ** 2 + (yy - r) ** 2) / (2 * 2.5**2))
    floor = Floor(np.repeat(mark[..., None], 3, axis=2).astype(np.uint8), 0.01)
    poses = np.array([pose(0.1, 0.2, 2.0, 0.4, 0.1, -0.12), pose(0.5, -0.6, 1.9, 2.6, -0.1, 0.05)])
    views = [photograph(floor, camera, T) for T in poses]
    plan = plan_mosaic(camera, poses, FLOOR_Z_M, gsd_m=gsd_m)
    grey = whole(plan, Pictures(plan, views.__getitem__))[..., 1].astype(float)
    weight = np.maximum(grey - 90, 0)
    rows, cols = np.mgrid[: plan.height, : plan.width]
    x = plan.west_m + ((weight * cols).sum() / weight.sum() + 0.5) * gsd_m
    y = plan.north_m - ((weight * rows).sum() / weight.sum() + 0.5) * gsd_m
    assert np.hypot(*(np.array([x, y]) - spot)) < 0.1 * max(gsd_m, 0.01)


def test_coverage_is_the_union_of_the_footprints() -> None:
    floor, poses = smooth_floor(1), survey(6, spacing_m=1.6)
    views = [photograph(floor, CAMERA, T, 1) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    covered = whole(plan, Pictures(plan, views.__getitem__))[..., 3] > 0
    union = np.zeros(covered.shape, np.uint8)
    for T in poses:
        xy = CAMERA.footprint(T, FLOOR_Z_M)
        pixel = (xy - [plan.west_m, plan.north_m]) / [plan.gsd_m, -plan.gsd_m] - 0.5
        cv2.fillConvexPoly(union, np.rint(pixel * 16).astype(np.int32), 1, shift=4)
    assert (union == 0).mean() > 0.05, "the scene must have holes"
    assert not (covered & ~cv2.dilate(union, np.ones((3, 3))).astype(bool)).any()
    missing = cv2.erode(union, np.ones((3, 3))).astype(bool) & ~covered
    assert missing.mean() < 2e-4


def test_coverage_does_not_depend_on_where_heights_count_from() -> None:
    floor, poses = smooth_floor(6), survey(2)
    views = [photograph(floor, CAMERA, T) for T in poses]
    flat = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=0.01)
    plan = over_depth(flat, poses, 0.5)
    assert (plan.width, plan.height) == (flat.width, flat.height)
    shown, expected = (whole(each, Pictures(each, views.__getitem__))[..., 3] > 0 for each in (plan, flat))
    # Whole cells are 16 pixels: those at the border are no more than touched by a picture.
    assert np.count_nonzero(shown != expected) < 1e-3 * np.count_nonzero(expected)


def test_tile_alone_equals_the_whole_without_visible_borders() -> None:
    floor, poses, rng = smooth_floor(1), survey(7), np.random.default_rng(8)
    # Exposure differs by a factor of two, so that bands cross seams with all their width.
    views = [
        np.clip(photograph(floor, CAMERA, T, 1) * rng.uniform(0.6, 1.2), 0, 255).astype(np.uint8)
        for T in poses
    ]
    plan = dataclasses.replace(plan_mosaic(CAMERA, poses, FLOOR_Z_M), tile_px=1024)
    neutral = Exposure.neutral(len(plan.views))
    big = whole(plan, Pictures(plan, views.__getitem__))
    small = dataclasses.replace(plan, tile_px=96)
    assert len(list(small.tiles)) > 8
    np.testing.assert_array_equal(whole(small, Pictures(plan, views.__getitem__))[..., 3], big[..., 3])
    difference = np.abs(whole(small, Pictures(plan, views.__getitem__)).astype(int) - big)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-3
    tile = list(small.tiles)[7]
    alone = render_tile(small, tile, Pictures(plan, views.__getitem__, max_mb=0.1), neutral)
    again = next(t for t in render_tiles(small, Pictures(plan, views.__getitem__), neutral) if t.tile == tile)
    np.testing.assert_array_equal(alone, again.rgba)


def test_strong_reduction_averages_pixels() -> None:
    rng = np.random.default_rng(9)
    floor = Floor(rng.integers(0, 256, (1000, 1000, 1), np.uint8).repeat(3, axis=2), 0.01)
    poses = np.array([pose(0, 0, 2.0), pose(0.8, 0.1, 2.0, 1.0)])
    views = [photograph(floor, CAMERA, T) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M, gsd_m=0.08)
    rgba = whole(plan, Pictures(plan, views.__getitem__))
    spread = rgba[..., 0][inner(rgba, 1)].std()
    # White noise of 74 grey levels over 8 x 8 texels has 74 / 8 left; picking would keep most of it.
    assert 4 < spread < 14


def test_unequal_exposure_is_compensated() -> None:
    floor, poses, rng = smooth_floor(1), survey(10, 3, 5), np.random.default_rng(11)
    factor = rng.uniform(0.8, 1.2, len(poses))
    views = [
        np.clip(np.rint(photograph(floor, CAMERA, T, 2) * f), 0, 255).astype(np.uint8)
        for T, f in zip(poses, factor, strict=True)
    ]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    pictures = Pictures(plan, views.__getitem__)
    exposure = measure_exposure(plan, pictures)
    assert exposure.seam_before > 0.1
    assert exposure.seam_after < 0.25 * exposure.seam_before
    truth = np.log(factor[[v.k for v in plan.views]])
    left = np.log(exposure.gain) + truth[:, None]
    assert left.std(axis=0).max() < 0.1 * truth.std()

    def unevenness(exposure: Exposure | None) -> float:
        rgba = whole(plan, pictures, exposure)
        ratio = rgba[..., :3].astype(float).mean(axis=2) / floor_under(plan, floor).mean(axis=2)
        return float(np.log(ratio[inner(rgba)]).std())

    assert unevenness(exposure) < 0.5 * unevenness(None)


def test_vignetting_is_compensated() -> None:
    floor, poses = smooth_floor(1), survey(14, 4, 5, spacing_m=0.6)
    v, u = np.mgrid[:150, :200]
    rho2 = ((u - 99.5) ** 2 + (v - 74.5) ** 2) / (99.5**2 + 74.5**2)
    shade = np.exp(-0.5 * rho2)[..., None]
    views = [np.rint(photograph(floor, CAMERA, T, 2) * shade).astype(np.uint8) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    pictures = Pictures(plan, views.__getitem__)

    def unevenness(exposure: Exposure | None) -> float:
        rgba = whole(plan, pictures, exposure)
        ratio = rgba[..., :3].astype(float).mean(axis=2) / floor_under(plan, floor).mean(axis=2)
        return float(np.log(ratio[inner(rgba)]).std())

    assert unevenness(measure_exposure(plan, pictures)) < 0.3 * unevenness(None)


def test_unusable_pictures_are_listed_and_replaced_by_others() -> None:
    floor, poses = smooth_floor(1), survey(12)
    views: list[np.ndarray | None] = [photograph(floor, CAMERA, T, 1) for T in poses]
    views[1] = None
    views[2] = np.zeros((150, 200, 3), np.uint8)
    views[3] = np.zeros((10, 200, 3), np.uint8)
    views[4] = np.zeros((150, 200, 3), np.uint16)
    views[5] = np.full((150, 200), 255, np.uint8)
    views[6] = cv2.cvtColor(views[6], cv2.COLOR_BGR2GRAY)
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    pictures = Pictures(plan, views.__getitem__)
    measure_exposure(plan, pictures)
    assert pictures.unusable == {
        1: "cannot be read",
        2: "black or blown out",
        3: "of another size than the camera's",
        4: "neither 8-bit grey nor colour",
        5: "black or blown out",
    }
    again = plan_mosaic(CAMERA, poses, FLOOR_Z_M, leave_out=pictures.unusable)
    assert not {v.k for v in again.views} & set(range(1, 6))
    pictures = Pictures(again, views.__getitem__)
    measure_exposure(again, pictures)
    assert not pictures.unusable


def test_pictures_in_memory_stay_below_the_limit() -> None:
    floor, poses = smooth_floor(1), survey(13)
    views = [photograph(floor, CAMERA, T, 1) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    read: list[int] = []

    def load(k: int) -> np.ndarray:
        read.append(k)
        return views[k]

    pictures = Pictures(plan, load, max_mb=3 * 0.09)
    for i in (0, 1, 2, 0, 3, 0, 1):
        assert pictures[i] is not None
    # Three fit: 1 had to go for 3 because 0 was used since.
    number = [v.k for v in plan.views]
    assert read == [number[i] for i in (0, 1, 2, 3, 1)]


def test_rectangle_without_pictures_is_transparent() -> None:
    floor = smooth_floor(1)
    poses = np.array([pose(-1.5, 0, 2.0), pose(1.5, 0, 2.0)])
    views = [photograph(floor, CAMERA, T, 1) for T in poses]
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    middle = Tile(0, plan.width // 2 - 20, plan.height, 40)
    done = render_tile(plan, middle, Pictures(plan, views.__getitem__), Exposure.neutral(2))
    assert not done.any()


def test_a_picture_that_is_read_again_is_judged_and_digested_once(monkeypatch) -> None:
    floor, poses = smooth_floor(1), survey(2)
    plan = plan_mosaic(CAMERA, poses, FLOOR_Z_M)
    read, counted = [], []
    for name in ("_digest", "_unusable_reason"):
        known = getattr(pictures_module, name)
        monkeypatch.setattr(
            pictures_module,
            name,
            lambda *inputs, known=known, name=name: counted.append(name) or known(*inputs),
        )
    pictures = Pictures(plan, lambda k: read.append(k) or photograph(floor, CAMERA, poses[k]), max_mb=0.001)
    first, other, again = (pictures[index] for index in (0, 1, 0))
    assert other is not None
    np.testing.assert_array_equal(first, again)
    assert len(read) == 3
    assert sorted(counted) == ["_digest"] * 2 + ["_unusable_reason"] * 2
