"""Projection kernels against gtsam's and OpenCV's cameras and numeric derivatives, with every number of the
calibration."""

from __future__ import annotations

import cv2
import gtsam
import numpy as np
import pytest

from backend.bundle.projections import linearise, residuals, undistorted

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


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("huber_sigmas", [2.0, 1e6])
def test_the_jacobians_are_the_numeric_derivatives(seed: int, huber_sigmas: float) -> None:
    pose, point, pixel = scene(seed)
    std_px = 0.7
    of_pose, of_point, of_calibration = (np.full((1, 2, d), np.nan) for d in (6, 3, CALIBRATION.size))
    right = linearise(
        pose.matrix()[None], point[None], CALIBRATION, OBSERVED, OBSERVED, pixel[None],
        np.array([std_px]), huber_sigmas, of_pose, of_point, of_calibration,
    )  # fmt: skip
    found = error(pose, point, CALIBRATION, pixel)
    weight = np.sqrt(min(1.0, huber_sigmas * std_px / np.linalg.norm(found))) / std_px
    np.testing.assert_allclose(right[0], -weight * found, rtol=1e-12)
    for ours, moved in (
        (of_pose, lambda x: error(pose.retract(x), point, CALIBRATION, pixel)),
        (of_point, lambda x: error(pose, point + x, CALIBRATION, pixel)),
        (of_calibration, lambda x: error(pose, point, CALIBRATION + x, pixel)),
    ):
        steps = 1e-6 * np.eye(ours.shape[2])
        numeric = np.column_stack([(moved(x) - moved(-x)) / 2e-6 for x in steps])
        np.testing.assert_allclose(ours[0], weight * numeric, rtol=1e-5, atol=1e-5 * weight)
