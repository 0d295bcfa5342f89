"""Two pictures registered, from features or from nothing in common."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig, FeatureKind, Features
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.motions import MOST_LEAD, Expectation
from frontend.points import Points
from frontend.registration import Registration, overlap, register
from tests.frontend.floor_pairs import CAMERA, pair, texture, true_homography
from tests.frontend.mosaic.scene import CAMERA as SMALL
from tests.frontend.mosaic.scene import photograph, pose, smooth_floor


def compare(a: Features, b: Features, camera: Camera = CAMERA) -> Registration:
    return register(3, 8, a, b, camera, HomographyConfig(), GateConfig())


def synthetic(rng: np.random.Generator, count: int, wrong: float) -> tuple[Features, Features, np.ndarray]:
    """Features of one floor in two pictures, 0.3 px of noise, some described alike at the wrong place."""
    H = true_homography(CAMERA, *pair(rng, 1.0, 1.0, 0.05))
    pixel_j = rng.uniform([0, 0], [319, 239], (count, 2))
    pixel_i = transfer(H, pixel_j) + rng.normal(0, 0.3, (count, 2))
    outlier = rng.random(count) < wrong
    pixel_i[outlier] = rng.uniform([0, 0], [319, 239], (outlier.sum(), 2))
    descriptor = rng.normal(size=(count, 32))
    descriptor = (descriptor / np.linalg.norm(descriptor, axis=1, keepdims=True)).astype(np.float32)
    return Features(Points.alike(pixel_i), descriptor), Features(Points.alike(pixel_j), descriptor), H


@pytest.mark.parametrize(
    "kind",
    [
        "sift",
        pytest.param("orb", marks=pytest.mark.slow),
        "orb-teblid",
        pytest.param("akaze", marks=pytest.mark.slow),
    ],
)
def test_pictures_of_a_floor_register_where_the_poses_say(kind: FeatureKind) -> None:
    """Two real renderings, all kinds of features, within four of their own standard deviations."""
    floor = smooth_floor(2, size=900, texel_m=0.006, blur=1.2)
    camera = replace(SMALL, focal_px=(320.0, 320.0), center_px=(159.5, 119.5), size_px=(320, 240))
    camera = replace(camera, distortion=(-0.2, 0.05, 0.001, -0.001))
    poses = pose(0.1, -0.2, 1.6, 0.4, 0.05, -0.03), pose(0.3, -0.1, 1.9, -0.5, -0.04, 0.02)
    extract = Extractor(FeatureConfig(kind))
    a, b = (extract(photograph(floor, camera, T), camera) for T in poses)
    link = compare(a, b, camera)
    assert link.ok, link.reason
    assert (link.i, link.j) == (3, 8)
    # Both stand over the floor of that scene, which is not at zero.
    H = np.linalg.inv(camera.floor_H_image(poses[0], 0.25)) @ camera.floor_H_image(poses[1], 0.25)
    corners = camera.undistort(camera.corners_px)
    error = (transfer(link.i_H_j, corners) - transfer(H, corners)).ravel()
    assert error @ np.linalg.solve(link.corner_covariance, error) < 36  # chi² with 8: 1 in 50 000
    assert np.abs(error).max() < 5.0
    residual = transfer(H, b.pixel[link.matches[:, 1]]) - a.pixel[link.matches[:, 0]]
    assert np.linalg.norm(residual, axis=1).max() < 6
    assert 0.05 <= link.noise_px < 0.9


def test_inliers_are_the_right_matches_and_carry_the_features_numbers() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        a, b, H = synthetic(rng, 200, 0.3)
        link = compare(a, b)
        assert link.ok, link.reason
        assert 100 < len(link.matches) < 175
        np.testing.assert_array_equal(link.matches[:, 0], link.matches[:, 1])
        distance = np.linalg.norm(
            transfer(H, b.pixel[link.matches[:, 1]]) - a.pixel[link.matches[:, 0]], axis=1
        )
        assert distance.max() < 5


def test_too_few_matches_no_plane_and_refusals_have_their_reason() -> None:
    rng = np.random.default_rng(2)
    a, b, _ = synthetic(rng, 14, 0.0)
    assert str(compare(a, b).reason) == "too few matches"
    a, b, _ = synthetic(rng, 100, 1.0)
    assert str(compare(a, b).reason) in (
        "too few inliers",
        "outlier share above gamma_1",
        "no plane fits the matches",
    )
    nearly = np.column_stack([50 + 1e-6 * np.arange(100), np.full(100, 60.0)])
    same = Features(Points.alike(nearly), a.descriptor)
    refused = compare(same, same)
    assert str(refused.reason) == "no plane fits the matches"
    assert not refused.ok
    assert np.isnan(refused.i_H_j).all()
    assert refused.matches.shape == (0, 2)
    line = np.array([[20.0, 30]]) + rng.uniform(0, 1, (100, 1)) * [250, 150]
    on_line = (
        Features(Points.alike(line), a.descriptor),
        Features(Points.alike(line + rng.normal(0, 0.2, line.shape)), a.descriptor),
    )
    assert str(compare(*on_line).reason) in (
        "no plane fits the matches",
        "inliers crowded in one place",
        "homography poorly determined",
        "folded or no overlap",
        "implausible change of scale",
    )


@pytest.mark.parametrize("ratio", [1 / 3, 0.5, 2.0, 3.0])
def test_pictures_from_very_different_heights_register(ratio: float) -> None:
    """The higher one shows nine times the ground: of that the lower one has hardly a tenth."""
    rng, shared, height_m = np.random.default_rng(5), [], max(ratio, 1 / ratio)
    for _ in range(10):
        low = pose(0.0, 0.0, 0.75, rng.uniform(-3, 3))
        high = pose(*rng.uniform(-0.35, 0.35, 2) * height_m, height_m - 0.25, rng.uniform(-3, 3))
        H = true_homography(CAMERA, low, high)
        seen_high = rng.uniform([0, 0], [319, 239], (600, 2))
        seen_low = transfer(H, seen_high)
        both = ((seen_low >= 0) & (seen_low <= [319, 239])).all(axis=1)
        seen_high, seen_low = seen_high[both], seen_low[both] + rng.normal(0, 0.3, (int(both.sum()), 2))
        descriptor = rng.normal(size=(len(seen_low), 32))
        descriptor = (descriptor / np.linalg.norm(descriptor, axis=1, keepdims=True)).astype(np.float32)
        i, j = (seen_low, seen_high) if ratio > 1 else (seen_high, seen_low)
        link = compare(Features(Points.alike(i), descriptor), Features(Points.alike(j), descriptor))
        assert link.ok, link.reason
        shared.append(link.overlap)
    assert (min(shared) < GateConfig().min_overlap) == (ratio == 3.0)


def test_random_features_never_register() -> None:
    """The same from descriptors on: the two pictures have nothing in common."""
    rng = np.random.default_rng(3)
    extract = Extractor()
    pictures = [texture(rng, 320, 240) for _ in range(6)]
    features = [extract(p, CAMERA) for p in pictures]
    for i in range(6):
        for j in range(i):
            assert not compare(features[i], features[j]).ok


def test_overlap_is_the_shared_area_and_zero_where_the_transfer_folds() -> None:
    assert overlap(np.eye(3), CAMERA) == pytest.approx(1.0)
    half, mirror, shrink, grow = np.eye(3), np.diag([-1.0, 1, 1]), np.eye(3), np.eye(3)
    half[0, 2] = 319 / 2
    mirror[0, 2] = 319
    shrink[:2, :2] *= 0.5
    grow[:2, :2] *= 2
    assert overlap(half, CAMERA) == pytest.approx(0.5)
    assert overlap(mirror, CAMERA) == 0.0  # no floor is seen mirrored
    assert overlap(shrink, CAMERA) == pytest.approx(1.0)
    assert overlap(grow, CAMERA) == pytest.approx(0.25)
    assert overlap(np.array([[1.0, 0, 0], [0, 1, 0], [-1 / 100, 0, 1]]), CAMERA) == 0.0
    half[0, 2] = 1e6
    assert overlap(half, CAMERA) == 0.0


def test_overlap_agrees_with_counting_pixels() -> None:
    rng = np.random.default_rng(4)
    u, v = np.meshgrid(np.linspace(0, 319, 160), np.linspace(0, 239, 120))
    grid = np.column_stack([u.ravel(), v.ravel()])
    for _ in range(20):
        i, j = pair(rng, 1.0, rng.uniform(0.6, 1.6), 0.05)
        H = true_homography(CAMERA, i, j)
        quad = transfer(H, CAMERA.corners_px).astype(np.float32)
        # Shares of area in picture i, so each pixel counts by how much it is stretched there.
        u = grid @ H[:, :2].T + H[:, 2]
        weight = np.abs(1.0 / u[:, 2]) ** 3
        seen = u[:, :2] / u[:, 2:]
        inside = ((seen >= 0) & (seen <= [319, 239])).all(axis=1)
        assert overlap(H, CAMERA) == pytest.approx((weight * inside).sum() / weight.sum(), abs=0.015)
        assert cv2.isContourConvex(quad)


def test_least_overlap_is_that_of_the_motion_that_overlaps_less() -> None:
    rng = np.random.default_rng(6)
    pixel_j = rng.uniform([0, 0], [319, 239], (500, 2))
    other = pixel_j[:, 0] > 190
    pixel_i = pixel_j + np.where(other[:, None], [0.0, 60.0], [20.0, 0.0]) + rng.normal(0, 0.2, (500, 2))
    descriptor = rng.normal(size=(500, 32))
    descriptor = (descriptor / np.linalg.norm(descriptor, axis=1, keepdims=True)).astype(np.float32)
    link = compare(Features(Points.alike(pixel_i), descriptor), Features(Points.alike(pixel_j), descriptor))
    assert link.ok, link.reason
    assert link.overlap == pytest.approx(1 - 20 / 319, abs=0.01)
    assert link.least_overlap == pytest.approx(1 - 60 / 239, abs=0.03)


def shown(floor: np.ndarray, x_px: float, rng: np.random.Generator) -> Features:
    """Features of a picture of a floor, with noise, from ``x_px`` to the right."""
    seen = cv2.warpAffine(
        floor, np.array([[1.0, 0, -x_px], [0, 1, 0]]), CAMERA.size_px, flags=cv2.INTER_CUBIC
    )
    seen = np.clip(seen + rng.normal(0, 2, seen.shape), 0, 255).astype(np.uint8)
    return Extractor(FeatureConfig())(seen, CAMERA)


def shift(x_px: float) -> np.ndarray:
    return np.array([[1.0, 0, x_px], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("period_px", [100, 150])
def test_on_a_repetitive_floor_the_expected_copy_is_found(period_px: int) -> None:
    rng = np.random.default_rng(5)
    floor = np.tile(texture(rng, period_px, 240), (1, 8))
    corners = CAMERA.undistort(CAMERA.corners_px)
    a, b = shown(floor, 0.0, rng), shown(floor, 130.3, rng)
    for copy_px in (130.3, 130.3 - period_px):
        expected = Expectation(transfer(shift(copy_px + 5), corners), MOST_LEAD)
        link = register(0, 1, a, b, CAMERA, HomographyConfig(), GateConfig(), expected)
        assert link.ok, link.reason
        assert np.abs(transfer(link.i_H_j, corners) - transfer(shift(copy_px), corners)).max() < 1.0


@pytest.mark.parametrize("off_px", [20, -60, 130])
def test_a_wrong_expectation_changes_nothing_on_other_floors(off_px: float) -> None:
    rng = np.random.default_rng(6)
    floor, corners = texture(rng, 600, 240), CAMERA.undistort(CAMERA.corners_px)
    a, b = shown(floor, 0.0, rng), shown(floor, 130.3, rng)
    expected = Expectation(transfer(shift(130.3 + off_px), corners), MOST_LEAD)
    link = register(3, 8, a, b, CAMERA, HomographyConfig(), GateConfig(), expected)
    np.testing.assert_allclose(link.i_H_j, compare(a, b).i_H_j, atol=0.05)
