"""Displacements between pictures of one piece of ground, and which squares have relief."""

import numpy as np
import pytest

from frontend.mosaic.plan import plan_mosaic
from frontend.surface.misregistration import (
    SQUARE_PX,
    Misregistration,
    seen_by_two,
)
from frontend.surface.relief import is_better, relief_squares, relief_threshold_px
from frontend.workers import Workers, share_with
from tests.frontend.mosaic.scene import FLOOR_Z_M
from tests.frontend.sent_workers import SentWorkers
from tests.frontend.surface.raised_plane import (
    CAMERA,
    GSD_M,
    HEIGHT_M,
    POSES,
    boxed,
    measured,
    photographs,
)


@pytest.fixture(scope="module")
def pictures():
    return photographs()


def test_pictures_of_a_flat_floor_agree_and_show_no_relief(pictures):
    _, found = measured(pictures, POSES, FLOOR_Z_M)
    assert len(found.square) > 4
    assert found.found.all()
    assert found.percentile_px(95) < 0.5
    assert not relief_squares(found).any()


def test_a_surface_that_flat_ground_does_not_have_is_no_better_than_the_floor(pictures):
    over_floor, over_box = (measured(pictures, POSES, FLOOR_Z_M, each)[1] for each in (None, boxed()))
    assert not is_better(over_box, over_floor)
    assert is_better(over_floor, over_box)
    assert not is_better(over_floor, over_floor)


def test_a_displaced_picture_is_misregistered_by_its_displacement(pictures):
    moved = POSES.copy()
    moved[1::2, 0, 3] += 6 * GSD_M
    _, found = measured(pictures, moved, FLOOR_Z_M)
    size = np.linalg.norm(found.shift_px[found.found], axis=1)
    # Two pictures of one square have moved by the same 6 px, or one of them has.
    assert np.all((size < 0.5) | (np.abs(size - 6) < 0.5))
    assert np.any(size > 5)


def test_displacements_do_not_depend_on_the_workers(pictures):
    found = []
    for chosen in (Workers(1), Workers(2), SentWorkers(2)):
        with share_with(chosen):
            found.append(measured(pictures, POSES, FLOOR_Z_M - HEIGHT_M)[1])
    assert len(np.unique(found[0].square[:, 1])) > 1
    for other in found[1:]:
        np.testing.assert_array_equal(other.shift_px, found[0].shift_px)
        np.testing.assert_array_equal(other.parallax_px_m, found[0].parallax_px_m)


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
    for _ in range(200):
        along, across = rng.standard_t(3, (2, 400))
        along[:100] += rng.choice([-1, 1], 100) * rng.uniform(5, 20, 100)
        taken = relief_squares(shifts(along, across)).ravel()
        shares.append(taken[100:].sum() / max(taken.sum(), 1))
        missed.append(1 - taken[:100].mean())
    assert 0.005 < np.mean(shares) < 0.05
    assert np.mean(missed) < 0.3
    assert relief_threshold_px(shifts(0.1 * along, 0.01 * across)) >= 0.5  # what nobody sees does not count


def test_squares_that_were_matched_wrongly_do_not_hide_the_relief():
    """One in fifty is displaced by anything. Those displaced far across had left every threshold too many."""
    rng, taken = np.random.default_rng(3), []
    for _ in range(20):
        along, across = 0.3 * rng.normal(size=(2, 1200))
        along[:250] += rng.choice([-1, 1], 250) * rng.uniform(2, 20, 250)
        along[-24:], across[-24:] = rng.uniform(-20, 20, (2, 24))
        taken.append(relief_squares(shifts(along, across)).ravel())
    of_relief, flat, _ = np.split(np.array(taken), [250, 1200 - 24], axis=1)
    assert of_relief.mean() > 0.9
    assert flat.mean() < 0.02


@pytest.mark.parametrize("count", [20, 60, 400])
def test_few_squares_far_beyond_the_others_are_found(count):
    """A house covers a square or two, which no rate of false discoveries can tell from flat ones."""
    rng = np.random.default_rng(1)
    flat = [shifts(*0.1 * rng.standard_t(3, (2, count))) for _ in range(400)]
    assert np.mean([relief_squares(case).any() for case in flat]) < 0.1
    along, across = 0.1 * rng.normal(size=(2, count))
    along[:2] = 17.7, -3.1
    assert np.flatnonzero(relief_squares(shifts(along, across)).ravel()).tolist() == [0, 1]


def test_a_house_of_two_squares_is_better_than_the_floor_whatever_flat_squares_do():
    rng = np.random.default_rng(2)
    before, after = 0.1 * rng.normal(size=(2, 2, 400))
    before[0, :2] = 17.7, np.nan
    assert is_better(shifts(*after), shifts(*before))
    assert not is_better(shifts(*before), shifts(*after))
    before[0, :2] = after[0, :2]
    assert not is_better(shifts(*after), shifts(*before))


def test_two_pictures_contain_the_corners_of_each_square_that_is_seen_by_two():
    plan = plan_mosaic(CAMERA, POSES, FLOOR_Z_M, 0.01)
    seen = seen_by_two(plan)
    assert np.argwhere(seen).tolist() == [[2, 1], [2, 2]]
    for row, column in np.argwhere(seen):
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
        assert containing >= 2
