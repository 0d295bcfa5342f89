"""Ground that slopes, in the level world of a GeoTIFF."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.misregistration import Misregistration
from slam.core.estimate import Estimate, over_floor
from slam.report.rasters.level_ground import is_level, level_bounds, levelled
from slam.report.rasters.surface import MeasuredGround
from tests.frontend.mosaic.scene import FLOOR_Z_M
from tests.frontend.surface.raised_plane import CAMERA, GSD_M, POSES, boxed
from tests.slam.made_estimate import made_estimate

NOTHING = Misregistration((0, 0), np.zeros((0, 2), np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
SLOPE_RAD = (0.4, -0.25)


@pytest.fixture(scope="module")
def plan():
    return plan_mosaic(CAMERA, POSES, FLOOR_Z_M, GSD_M)


def leaning(slope_rad: tuple[float, float]) -> Estimate:
    """A map whose ground slopes, of pictures that stand over its plane at ``POSES``."""
    w_T_b = over_floor(POSES, (-slope_rad[0], -slope_rad[1]), FLOOR_Z_M)
    return replace(made_estimate(), w_T_b=w_T_b, floor_z_m=FLOOR_Z_M, floor_slope_rad=slope_rad)


def places(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = surface.height_m.shape
    x = surface.west_m + (np.arange(cols) + 0.5) * surface.cell_m
    y = surface.north_m - (np.arange(rows) + 0.5) * surface.cell_m
    return np.meshgrid(x, y)


def test_flat_ground_has_the_heights_of_its_plane(plan):
    estimate = leaning(SLOPE_RAD)
    ground = levelled(MeasuredGround(NOTHING, None), plan, estimate)
    x, y = places(ground.surface)
    normal = Rotation.from_rotvec([*SLOPE_RAD, 0.0]).as_matrix()[:, 2]
    plane = -(normal[0] * x + normal[1] * y) / normal[2]
    assert np.abs(ground.surface.height_m - plane).max() < 1e-5
    compared = ground.surface.source == HeightSource.FLOOR
    assert (ground.surface.source[~compared] == HeightSource.LEVEL).all()
    assert np.isnan(ground.surface.std_m).all(), "nothing measured the heights of flat ground"
    across_m2 = compared.sum() * ground.surface.cell_m**2
    assert across_m2 == pytest.approx(plan.width * plan.height * GSD_M**2 * normal[2], rel=0.05)


def test_the_ground_in_each_picture_lies_inside_of_its_bounds(plan):
    estimate = leaning(SLOPE_RAD)
    surface, bounds = (
        levelled(MeasuredGround(NOTHING, None), plan, estimate).surface,
        level_bounds(plan, estimate),
    )
    assert sorted(bounds) == list(range(len(POSES)))
    corner_px = CAMERA.corners_px
    for k, pose in enumerate(POSES):
        over_plane = np.column_stack([CAMERA.floor_points(pose, corner_px, FLOOR_Z_M), np.zeros(4)])
        x, y = (over_plane @ Rotation.from_rotvec([*SLOPE_RAD, 0.0]).as_matrix().T)[:, :2].T
        west, south, east, north = bounds[k]
        assert ((x > west - 1e-6) & (x < east + 1e-6) & (y > south - 1e-6) & (y < north + 1e-6)).all()
        assert surface.west_m < west
        assert north < surface.north_m


@pytest.mark.parametrize("slope_rad", [(0.02, 0.01), SLOPE_RAD])
def test_a_box_on_a_slope_stands_where_its_points_are(plan, slope_rad):
    """Each cell of its top is turned by hand, and is found within a cell of the level world."""
    estimate, box = leaning(slope_rad), boxed(0.3)
    box = replace(box, std_m=np.full_like(box.height_m, 0.01))
    ground = levelled(MeasuredGround(NOTHING, box), plan, estimate)
    level, turn = ground.surface, Rotation.from_rotvec([*slope_rad, 0.0]).as_matrix()
    x, y = places(box)
    top = cv2.erode(box.height_m, np.ones((5, 5))) > 0  # a cell of the level world may cross an edge
    w_p = np.column_stack([x[top], y[top], box.height_m[top]]) @ turn.T
    c = np.floor((w_p[:, 0] - level.west_m) / level.cell_m).astype(int)
    r = np.floor((level.north_m - w_p[:, 1]) / level.cell_m).astype(int)
    steepest = np.hypot(*turn[2, :2]) / turn[2, 2]
    assert np.abs(level.height_m[r, c] - w_p[:, 2]).max() < 1.5 * level.cell_m * steepest + 1e-4
    assert (level.source[r, c] == HeightSource.PICTURES).all()
    found = level.source != HeightSource.LEVEL
    assert found.sum() == pytest.approx(box.height_m.size * turn[2, 2], rel=0.1), "ground around it too"
    floor = found & (level.source == HeightSource.FLOOR)
    x, y = places(level)
    plane = -(turn[0, 2] * x + turn[1, 2] * y) / turn[2, 2]
    assert np.abs(level.height_m - plane)[floor].max() < 1e-5
    assert level.std_m[r, c] == pytest.approx(0.01 / turn[2, 2])
    assert ground.height_std_m[r, c] == pytest.approx(0.01 / turn[2, 2])
    assert ground.pits.shape == level.height_m.shape


def test_a_slope_counts_where_it_moves_ground_by_a_pixel_or_a_height_by_a_cell(plan):
    flat, box = MeasuredGround(NOTHING, None), MeasuredGround(NOTHING, boxed(0.3))
    for slope_rad, flat_is_level, box_is_level in (
        (0.0, True, True),
        (0.03, True, False),
        (0.4, False, False),
    ):
        estimate = leaning((slope_rad, 0.0))
        assert is_level(estimate, plan, flat) == flat_is_level
        assert is_level(estimate, plan, box) == box_is_level
