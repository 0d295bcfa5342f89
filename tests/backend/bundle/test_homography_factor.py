"""The homography between two pictures of a floor: gtsam's projection, Jacobians by differences, poses."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from backend import se3
from backend.bundle.homography_factor import (
    ROWS,
    ImagePlane,
    homography_factor,
    homography_whitening,
    place,
    transfer,
)

PLANE = ImagePlane(np.array([200.0, 210.0]), np.array([160.0, 120.0]))
CORNERS = np.array([[0.0, 0.0], [320.0, 0.0], [320.0, 240.0], [0.0, 240.0]])
RAYS = PLANE.rays(CORNERS)
DOWN = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])


def pair(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses (1, 4, 4) of two cameras that look down on one piece of floor."""
    rng = np.random.default_rng(seed)
    first, second = DOWN @ se3.exp(rng.normal(0, 0.1, (2, 6)))
    return first[None], second[None]


def differences(error, start: np.ndarray) -> np.ndarray:
    steps = np.vstack([np.eye(6), -np.eye(6)]) * 1e-6
    moved = np.array([error(start @ se3.exp(step[None])) for step in steps])
    return (moved[:6] - moved[6:]).T / 2e-6


@pytest.mark.parametrize("seed", range(3))
def test_points_are_where_gtsam_projects_the_floor(seed):
    f_T_k, f_T_j = pair(seed)
    K = gtsam.Cal3_S2(*PLANE.focal_px, 0.0, *PLANE.center_px)
    k, j = (gtsam.PinholeCameraCal3_S2(gtsam.Pose3(T[0]), K) for T in (f_T_k, f_T_j))
    found = transfer(f_T_k, f_T_j, RAYS[None], PLANE).pixel[0].reshape(4, 2)
    for corner, pixel in zip(CORNERS, found, strict=True):
        eye, ahead = f_T_j[0, :3, 3], j.backproject(corner, 1.0)
        on_floor = eye + (ahead - eye) * eye[2] / (eye[2] - ahead[2])
        np.testing.assert_allclose(pixel, k.project(on_floor), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_jacobians_are_those_of_differences(seed):
    f_T_k, f_T_j = pair(seed)
    found = transfer(f_T_k, f_T_j, RAYS[None], PLANE)
    by_k = differences(lambda T: transfer(T, f_T_j, RAYS[None], PLANE).pixel[0], f_T_k)
    by_j = differences(lambda T: transfer(f_T_k, T, RAYS[None], PLANE).pixel[0], f_T_j)
    np.testing.assert_allclose(found.by_keyframe[0], by_k, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(found.by_frame[0], by_j, rtol=1e-5, atol=1e-4)


def test_a_slope_of_the_floor_is_a_rotation_of_both_cameras_about_the_nadir():
    f_T_k, f_T_j = pair(0)
    nadir = np.eye(4)
    nadir[:2, 3] = f_T_k[0, :2, 3]
    slope = 1e-6
    # The floor z = slope x is level seen from cameras that are turned by the slope about y.
    turn = nadir @ se3.exp(np.array([[0.0, slope, 0, 0, 0, 0]]))[0] @ np.linalg.inv(nadir)
    level, sloped = (transfer(T @ f_T_k, T @ f_T_j, RAYS[None], PLANE) for T in (np.eye(4)[None], turn[None]))
    moved = (sloped.pixel - level.pixel)[0] / slope
    np.testing.assert_allclose(level.by_slope[0, :, 0], moved, rtol=1e-4, atol=1e-3)


def test_a_picture_is_placed_where_its_homography_says():
    f_T_k, f_T_j = pair(1)
    pixel = transfer(f_T_k, f_T_j, RAYS[None], PLANE).pixel
    np.testing.assert_allclose(place(f_T_k, RAYS[None], pixel, PLANE), f_T_j, atol=1e-9)


def test_a_homography_does_not_tell_the_tilt_of_the_pair():
    """Both cameras tilted over a sloped floor see the same: the factor must not resist by much."""
    f_T_k, f_T_j = pair(2)
    found = transfer(f_T_k, f_T_j, RAYS[None], PLANE)
    W = homography_whitening(0.01 * np.eye(ROWS), found.by_slope[0])
    J = np.hstack([W @ found.by_keyframe[0], W @ found.by_frame[0]])
    # With the picture's pose free, what remains on the keyframe's tilt is the prior on the slope.
    information = J.T @ J
    mixed, own = information[:6, 6:], information[6:, 6:]
    left = information[:6, :6] - mixed @ np.linalg.solve(own, mixed.T)
    assert np.linalg.eigvalsh(left).max() < 1.3 / 0.05**2
    model = gtsam.noiseModel.Unit.Create(ROWS)
    factor = homography_factor((0, 1), RAYS, found.pixel[0], PLANE, W, model)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(f_T_k[0]))
    values.insert(1, gtsam.Pose3(f_T_j[0]))
    assert factor.error(values) < 1e-12
    np.testing.assert_allclose(factor.linearize(values).jacobian()[0], J)
