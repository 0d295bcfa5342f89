"""Projection kernels against gtsam's and OpenCV's cameras and numeric derivatives, with every number of the
calibration."""

from __future__ import annotations

import cv2
import gtsam
import numpy as np
import pytest

from backend.bundle.projections import distorted, linearise, residuals, undistorted

FISHEYE = np.array([410.0, 390.0, 320.0, 240.0, 0.05, -0.03, 0.02, -0.01])
CALIBRATION = np.array([410.0, 390.0, 320.0, 240.0, -0.2, 0.05, 0.01, -0.02, 0.03])
OBSERVED = np.zeros(1, dtype=np.int64)


def scene(seed: int) -> tuple[gtsam.Pose3, np.ndarray, np.ndarray]:
    """A tilted camera over the floor, a point that it sees, and the measured pixel."""
    rng = np.random.default_rng(seed)
    down = gtsam.Rot3(np.diag([1.0, -1.0, -1.0])).retract(rng.normal(0, 0.2, 3))
    pose = gtsam.Pose3(down, np.array([*rng.normal(0, 1, 2), 1.0]))
    ray = np.array([*rng.uniform(-0.5, 0.5, 2), 1.0])
    return pose, np.asarray(pose.transformFrom(ray * rng.uniform(0.5, 2.0))), rng.uniform(0, 480, 2)


def error(pose: gtsam.Pose3, point: np.ndarray, calibration: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    return residuals(pose.matrix()[None], point[None], calibration, OBSERVED, OBSERVED, pixel[None])[0]


@pytest.mark.parametrize("seed", range(20))
def test_the_projection_is_that_of_gtsam(seed: int) -> None:
    pose, point, pixel = scene(seed)
    fx, fy, cx, cy, k1, k2, p1, p2, _ = CALIBRATION
    theirs = gtsam.PinholeCameraCal3DS2(pose, gtsam.Cal3DS2(fx, fy, 0, cx, cy, k1, k2, p1, p2)).project(point)
    without_k3 = CALIBRATION * (np.arange(9) < 8)
    np.testing.assert_allclose(error(pose, point, without_k3, pixel), theirs - pixel, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_projection_is_that_of_opencv(seed: int) -> None:
    pose, point, pixel = scene(seed)
    fx, fy, cx, cy, *distortion = CALIBRATION
    c_p, K = pose.transformTo(point), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    theirs = cv2.projectPoints(c_p[None], np.zeros(3), np.zeros(3), K, np.array(distortion))[0].ravel()
    np.testing.assert_allclose(error(pose, point, CALIBRATION, pixel), theirs - pixel, atol=1e-9)


def test_rays_of_recorded_pixels_are_projected_onto_them() -> None:
    fx, fy, cx, cy, *distortion = CALIBRATION
    pixel = np.random.default_rng(0).uniform([40, 40], [600, 440], (200, 2))
    rays = np.column_stack([undistorted(CALIBRATION, pixel), np.ones(len(pixel))])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    back = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, np.array(distortion))[0].reshape(-1, 2)
    np.testing.assert_allclose(back, pixel, atol=1e-6)


def test_a_fisheye_projects_and_undistorts_as_that_of_opencv() -> None:
    fx, fy, cx, cy, *distortion = FISHEYE
    pixel = np.random.default_rng(0).uniform([0, 0], [640, 480], (200, 2))
    pixel[0] = cx, cy
    rays = np.column_stack([undistorted(FISHEYE, pixel), np.ones(len(pixel))])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    theirs = cv2.fisheye.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), K, np.array(distortion))[0]
    np.testing.assert_allclose(theirs.reshape(-1, 2), pixel, atol=1e-9)
    np.testing.assert_allclose(distorted(FISHEYE, rays[:, :2].copy()), pixel, atol=1e-9)


def test_on_its_axis_a_fisheye_is_smooth() -> None:
    """The series at the axis continues the formula outside it."""
    for at in (np.array([1e-4 * (1 - 1e-6), 0.0]), np.array([1e-4 * (1 + 1e-6), 0.0])):
        pose, depth = gtsam.Pose3(), np.array([*at, 1.0])
        of_point, of_lens = jacobians(pose, depth, FISHEYE, np.zeros(2), 1.0, np.inf)[1][1:]
        assert of_point[0, 0] / FISHEYE[0] == pytest.approx(
            1 + 3 * (FISHEYE[4] - 1 / 3) * at[0] ** 2, abs=1e-12
        )
        assert of_lens[0, 4] == pytest.approx(FISHEYE[0] * at[0] ** 3, rel=1e-6)


def jacobians(
    pose: gtsam.Pose3, point: np.ndarray, lens: np.ndarray, pixel: np.ndarray, std_px: float, huber: float
) -> tuple[np.ndarray, list[np.ndarray]]:
    found = [np.full((1, 2, d), np.nan) for d in (6, 3, lens.size)]
    right = linearise(
        pose.matrix()[None],
        point[None],
        lens,
        OBSERVED,
        OBSERVED,
        pixel[None],
        np.array([std_px]),
        huber,
        *found,
    )
    return right[0], [J[0] for J in found]


@pytest.mark.parametrize("lens", [CALIBRATION, FISHEYE], ids=["brown", "fisheye"])
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("huber_sigmas", [2.0, 1e6])
def test_the_jacobians_are_the_numeric_derivatives(seed: int, huber_sigmas: float, lens: np.ndarray) -> None:
    pose, point, pixel = scene(seed)
    std_px = 0.7
    right, found = jacobians(pose, point, lens, pixel, std_px, huber_sigmas)
    off = error(pose, point, lens, pixel)
    weight = np.sqrt(min(1.0, huber_sigmas * std_px / np.linalg.norm(off))) / std_px
    np.testing.assert_allclose(right, -weight * off, rtol=1e-12)
    moved = (
        lambda x: error(pose.retract(x), point, lens, pixel),
        lambda x: error(pose, point + x, lens, pixel),
        lambda x: error(pose, point, lens + x, pixel),
    )
    for ours, to in zip(found, moved, strict=True):
        steps = 1e-6 * np.eye(ours.shape[1])
        numeric = np.column_stack([(to(x) - to(-x)) / 2e-6 for x in steps])
        np.testing.assert_allclose(ours, weight * numeric, rtol=1e-5, atol=1e-5 * weight)
