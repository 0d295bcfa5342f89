"""Quality rasters, compared with sampled poses, brute force and pictures of known brightness."""

from __future__ import annotations

import numpy as np
import pytest

from backend import se3
from frontend.camera import Camera
from frontend.mosaic.canvas import CELL_PX
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.quality import ground_std, mosaic_quality
from frontend.mosaic.render import measure_exposure
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view
from tests.frontend.mosaic.scene import FLOOR_Z_M, pose

CAMERA = Camera((180.0, 180.0), (79.5, 59.5), (160, 120))


def grid_of_poses(tilt: float = 0.0) -> np.ndarray:
    return np.array([pose(0.5 * k % 2, 0.4 * (k // 4), 1.0, yaw=0.3 * k, pitch=tilt) for k in range(12)])


def test_standard_deviation_agrees_with_sampled_poses():
    """Sample poses with the covariance and intersect the ray of each pixel with the floor."""
    rng = np.random.default_rng(3)
    w_T_b = pose(0.4, -0.2, 1.1, yaw=0.7, pitch=0.15, roll=-0.1)
    A = rng.normal(0, 1, (6, 6)) * [[1], [1], [1], [2], [2], [2]]
    covariance = 1e-6 * A @ A.T
    view = mosaic_view(CAMERA, 0, w_T_b, FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    lattice = Lattice(0.1, 0.2, 0.25, 3, 4)
    found = ground_std(view, w_T_b, covariance, lattice, FLOOR_Z_M)
    drawn = w_T_b @ se3.exp(rng.multivariate_normal(np.zeros(6), covariance, 20_000))
    for r, c in ((0, 0), (1, 3), (2, 2)):
        p = np.array([0.1 + 0.25 * c, 0.2 - 0.25 * r, FLOOR_Z_M])
        ray_in_body = w_T_b[:3, :3].T @ (p - w_T_b[:3, 3])
        ray = drawn[:, :3, :3] @ ray_in_body
        hit = drawn[:, :3, 3] + ray * ((FLOOR_Z_M - drawn[:, 2, 3]) / ray[:, 2])[:, None]
        expected = np.sqrt(hit[:, :2].var(axis=0).sum())
        assert found[r, c] == pytest.approx(expected, rel=0.03)


def test_an_error_of_the_height_displaces_ground_along_the_ray():
    w_T_b = pose(0.4, -0.2, 1.1, yaw=0.7, pitch=0.15, roll=-0.1)
    view = mosaic_view(CAMERA, 0, w_T_b, FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    lattice, height_m = Lattice(0.1, 0.2, 0.25, 3, 4), np.float32(0.2)
    heights = np.full((3, 4), FLOOR_Z_M + height_m, np.float32)
    found = ground_std(view, w_T_b, np.zeros((6, 6)), lattice, heights, 0.05)
    drawn_m = heights[0, 0] + np.random.default_rng(5).normal(0.0, 0.05, 20_000)
    for r, c in ((0, 0), (1, 3), (2, 2)):
        p = np.array([0.1 + 0.25 * c, 0.2 - 0.25 * r, heights[r, c]])
        ray = p - view.w_p_c_m
        hit = view.w_p_c_m + ray * ((drawn_m - view.w_p_c_m[2]) / ray[2])[:, None]
        assert found[r, c] == pytest.approx(np.sqrt(hit[:, :2].var(axis=0).sum()), rel=0.03)


def test_each_cell_counts_the_pictures_that_contain_its_centre():
    w_T_b = grid_of_poses(tilt=0.1)
    plan = plan_mosaic(CAMERA, w_T_b, FLOOR_Z_M, gsd_m=0.01)
    black = np.zeros((120, 160, 3), np.uint8)
    pictures = Pictures(plan, lambda k: black + 100)
    exposure = measure_exposure(plan, pictures)
    quality = mosaic_quality(plan, exposure, w_T_b, np.tile(1e-6 * np.eye(6), (12, 1, 1)))
    rows, cols = plan.owner.shape
    assert quality.cell_m == pytest.approx(CELL_PX * 0.01)
    for r in range(0, rows, 3):
        for c in range(0, cols, 3):
            if plan.owner[r, c] < 0:
                assert np.isnan(quality.pictures[r, c])
                continue
            x = plan.west_m + (c + 0.5) * quality.cell_m
            y = plan.north_m - (r + 0.5) * quality.cell_m
            w_p = np.array([x, y, FLOOR_Z_M])
            inside = 0
            for T in w_T_b @ CAMERA.b_T_c:
                ray = T[:3, :3].T @ (w_p - T[:3, 3])
                u, v = 180 * ray[:2] / ray[2] + (79.5, 59.5)
                inside += ray[2] > 0 and 0 <= u <= 159 and 0 <= v <= 119
            assert quality.pictures[r, c] == max(inside, 1)


def test_seam_band_shows_where_pictures_disagree():
    """One of three pictures of a grey floor has a bright patch: the seam band has it, and only there."""
    w_T_b = np.array([pose(0.0, 0.0, 1.0), pose(0.1, 0.0, 1.0), pose(-0.1, 0.05, 1.0)])
    plan = plan_mosaic(CAMERA, w_T_b, FLOOR_Z_M, gsd_m=0.004)

    def load(k: int) -> np.ndarray:
        picture = np.full((120, 160, 3), 100, np.uint8)
        if k == 1:
            picture[30:60, 60:100] = 130
        return picture

    exposure = measure_exposure(plan, Pictures(plan, load))
    quality = mosaic_quality(plan, exposure, w_T_b, np.tile(1e-6 * np.eye(6), (3, 1, 1)))
    patch = CAMERA.floor_H_image(w_T_b[1], FLOOR_Z_M) @ [79.5, 44.5, 1]
    x, y = patch[:2] / patch[2]
    at = int((plan.north_m - y) / quality.cell_m), int((x - plan.west_m) / quality.cell_m)
    # Three readings, one a quarter brighter: their rms difference is 1.15 times a quarter over root two.
    assert quality.seam_share[at] == pytest.approx(np.log(1.3) * np.sqrt(2 / 3), rel=0.2)
    assert np.nanmedian(quality.seam_share) < 0.02
