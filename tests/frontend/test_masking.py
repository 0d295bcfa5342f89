"""Which pixels are masked: those where a box, projected point by point, appears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from frontend.elevation import Elevation
from frontend.masking import ObstacleMask, hides
from tests.frontend.floor_pairs import body

CAMERA = Camera((250.0, 250.0), (159.5, 119.5), (320, 240))
BARREL = replace(CAMERA, distortion=(-0.25, 0.06, 0.001, -0.001))
HIGH_M, GSD_M = 0.3, 0.02


def box_map() -> Elevation:
    """4 m x 4 m about the origin with a box from (0.1, -0.2) to (0.5, 0.2); nothing beyond 1.8 m."""
    centre = -2 + GSD_M * (np.arange(200) + 0.5)
    x, y = centre[None], -centre[:, None]
    height = np.where((x > 0.1) & (x < 0.5) & (np.abs(y) < 0.2), HIGH_M, 0.0) + 0 * x * y
    height[np.broadcast_to(np.hypot(x, y) > 1.8, height.shape)] = np.nan
    return Elevation(-2.0, 2.0, GSD_M, height.astype(np.float32))


@pytest.mark.parametrize("camera", [CAMERA, BARREL])
@pytest.mark.parametrize(
    "pose", [(0.2, 0.1, 1.0), (0.0, 0.3, 0.8, 1.9, 0.1, -0.08), (-0.2, -0.1, 1.5, -2.5, -0.1, 0.05)]
)
def test_the_box_is_masked_from_foot_to_top_and_the_floor_is_not(camera, pose):
    w_T_b = body(*pose)
    mask = ObstacleMask(box_map(), camera, 0.0, 0.06)(w_T_b)
    assert mask.shape == (240, 320)
    assert set(np.unique(mask)) == {0, 255}
    rng = np.random.default_rng(0)

    def seen(points: np.ndarray) -> np.ndarray:
        w_T_c = w_T_b @ camera.b_T_c
        pixel = np.rint(camera.project((points - w_T_c[:3, 3]) @ w_T_c[:3, :3])).astype(int)
        inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] < 320) & (pixel[:, 1] < 240)
        return mask[pixel[inside, 1], pixel[inside, 0]]

    box = np.column_stack(
        [rng.uniform(0.12, 0.48, 3000), rng.uniform(-0.18, 0.18, 3000), rng.uniform(0, 1, 3000) * HIGH_M]
    )
    top = np.where(np.arange(3000)[:, None] % 2 == 0, box * [1, 1, 0] + [0, 0, HIGH_M], box * [1, 1, 0])
    assert len(seen(top)) > 500
    assert (seen(top) == 0).mean() > 0.99
    assert (seen(box) == 0).mean() > 0.95
    floor = np.column_stack([rng.uniform(-1, 1, (4000, 2)), np.zeros(4000)])
    shadow = (HIGH_M / (pose[2] - HIGH_M)) * 1.0  # as far as the top leans over the floor, and a margin
    away = (floor[:, 0] < 0.1 - shadow) | (floor[:, 0] > 0.5 + shadow) | (np.abs(floor[:, 1]) > 0.2 + shadow)
    free = seen(floor[away])
    assert len(free) == 0 or (free == 255).all()


def test_without_a_box_in_view_above_gamma_or_a_pose_there_is_no_mask():
    mask = ObstacleMask(box_map(), CAMERA, 0.0, 0.06)
    assert mask(body(-1.0, -0.8, 0.6)) is None
    assert mask(np.full((4, 4), np.nan)) is None
    assert ObstacleMask(box_map(), CAMERA, 0.0, 0.31)(body(0.2, 0.1, 1.0)) is None
    raised = ObstacleMask(box_map(), CAMERA, 5.0, 0.06)
    np.testing.assert_array_equal(raised(body(0.2, 0.1, 6.0)), mask(body(0.2, 0.1, 1.0)))


def test_the_mask_reaches_beyond_the_edge_of_the_obstacle():
    w_T_b = body(0.2, 0.1, 1.0)
    mask = ObstacleMask(box_map(), CAMERA, 0.0, 0.06)(w_T_b)
    y = np.linspace(-0.15, 0.15, 200)
    top = np.column_stack([np.full(200, 0.5), y, np.full(200, HIGH_M)])
    w_T_c = w_T_b @ CAMERA.b_T_c
    pixel = CAMERA.project((top - w_T_c[:3, 3]) @ w_T_c[:3, :3])
    middle = CAMERA.project((np.array([[0.3, 0.0, HIGH_M]]) - w_T_c[:3, 3]) @ w_T_c[:3, :3])
    outwards = np.sign(pixel[:, 1].mean() - middle[0, 1])
    column, row = np.rint(pixel + [0, 2 * outwards]).astype(int).T
    assert ((row >= 0) & (row < 240)).all()
    assert (mask[row, column] == 0).all()


@pytest.mark.parametrize("camera", [CAMERA, BARREL])
def test_a_mask_hides_what_was_recorded_under_it(camera):
    mask = np.full((240, 320), 255, np.uint8)
    mask[100:110, 20:30] = 0
    hidden, beside = camera.undistort(np.array([[25.0, 105.0], [35.0, 105.0]]))
    assert hides(mask, np.array([beside, hidden]), camera).tolist() == [False, True]
    assert hides(None, np.array([hidden]), camera).tolist() == [False]
    assert hides(mask, np.empty((0, 2)), camera).shape == (0,)
