"""Heights of the ground from two pictures of a plane at a known height."""

from dataclasses import replace

import numpy as np
import pytest

from frontend.mosaic.view import Lattice, mosaic_view
from frontend.surface.stereo import Placed, ground_points, rectified
from tests.frontend.mosaic.scene import FLOOR_Z_M, pose
from tests.frontend.surface.raised_plane import CAMERA, GSD_M, HEIGHT_M, POSES, photographs


@pytest.fixture(scope="module")
def pictures():
    return photographs()


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
