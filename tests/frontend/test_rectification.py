"""Features of a distorted picture have the positions of an ideal pinhole."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig
from frontend.rectification import rectifier

SIZE_PX = (240, 180)
FOCAL_PX = 143.0
CENTER_PX = ((SIZE_PX[0] - 1) / 2, (SIZE_PX[1] - 1) / 2)
BARREL = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, (-0.28, 0.07, 0.0, 0.0))
MARGIN_PX = 60
"""Margin of the ideal picture at each border of the recorded one, in pixels."""


def ideal_picture(seed: int) -> np.ndarray:
    """Smooth blotches of 2 to 6 px, ``MARGIN_PX`` px larger on each side."""
    rng = np.random.default_rng(seed)
    height, width = SIZE_PX[1] + 2 * MARGIN_PX, SIZE_PX[0] + 2 * MARGIN_PX
    layers = [
        cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma) * sigma for sigma in (1.5, 3.0)
    ]
    picture = sum(layers)
    return np.clip(128 + 60 * picture / picture.std(), 0, 255).astype(np.uint8)


def recorded_by(camera: Camera, ideal: np.ndarray) -> np.ndarray:
    """Return the distorted picture that the camera records."""
    u, v = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    at = camera.undistort(np.column_stack([u.ravel(), v.ravel()])) + MARGIN_PX
    x, y = at.astype(np.float32).T.reshape(2, SIZE_PX[1], SIZE_PX[0])
    return cv2.remap(ideal, x, y, cv2.INTER_CUBIC)


def detected_and_true(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 2) of a recorded picture and the nearest one of the ideal picture, at most 1 px away."""
    ideal = ideal_picture(seed)
    found = Extractor()(recorded_by(BARREL, ideal), BARREL).pixel
    large = (ideal.shape[1], ideal.shape[0])
    center = (CENTER_PX[0] + MARGIN_PX, CENTER_PX[1] + MARGIN_PX)
    everything = Extractor(FeatureConfig(max_features=4000))
    true = everything(ideal, Camera((FOCAL_PX, FOCAL_PX), center, large)).pixel - MARGIN_PX
    distance, nearest = cKDTree(true).query(found)
    return found[distance < 1.0], true[nearest[distance < 1.0]]


def test_features_have_no_systematic_radial_error():
    pairs = [detected_and_true(seed) for seed in range(4)]
    found, true = (np.concatenate(side) for side in zip(*pairs, strict=True))
    error, radius = found - true, true - CENTER_PX
    far = np.linalg.norm(radius, axis=1) > 80
    assert far.sum() > 200
    outwards = np.sum(error * radius, axis=1)[far] / np.linalg.norm(radius, axis=1)[far]
    assert abs(outwards.mean()) < 0.02
    assert np.median(np.linalg.norm(error, axis=1)) < 0.2


def test_no_features_lie_outside_the_recorded_picture():
    pixel = Extractor()(recorded_by(BARREL, ideal_picture(5)), BARREL).pixel
    shown = BARREL.project(BARREL.rays(pixel))
    assert len(pixel) > 100
    assert (shown > -1).all()
    assert (shown < np.array(SIZE_PX)).all()
    # Some lie outside the bounds of an ideal picture of the same size.
    assert (pixel < 0).any() or (pixel > np.array(SIZE_PX)).any()


def test_a_mask_hides_its_part_of_the_recorded_picture():
    mask = np.full(SIZE_PX[::-1], 255, np.uint8)
    mask[:, :120] = 0
    pixel = Extractor()(recorded_by(BARREL, ideal_picture(6)), BARREL, mask).pixel
    assert len(pixel) > 50
    assert (BARREL.project(BARREL.rays(pixel))[:, 0] > 118).all()


def test_a_reduced_picture_has_its_features_at_the_same_place():
    picture = recorded_by(BARREL, ideal_picture(7))
    twice = cv2.resize(picture, (2 * SIZE_PX[0], 2 * SIZE_PX[1]), interpolation=cv2.INTER_CUBIC)
    center = tuple((c + 0.5) * 2 - 0.5 for c in CENTER_PX)
    large = Camera((2 * FOCAL_PX, 2 * FOCAL_PX), center, (480, 360), BARREL.distortion)
    reduced = Extractor(FeatureConfig(max_side_px=240))(twice, large).pixel
    at = (Extractor()(picture, BARREL).pixel + 0.5) * 2 - 0.5
    distance = cKDTree(at).query(reduced)[0]
    assert np.median(distance) < 0.2


@pytest.mark.parametrize("distortion", [(-3.0, 9.0, 0.0, 0.0), (5.0, 0.0, 0.0, 0.0), (-0.9, 0.0, 0.3, 0.3)])
def test_features_are_finite_for_an_impossible_lens(distortion: tuple[float, ...]):
    camera = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, distortion)
    pixel = Extractor()(recorded_by(BARREL, ideal_picture(8)), camera).pixel
    assert np.isfinite(pixel).all()


def test_an_ideal_lens_has_no_rectifier():
    assert rectifier(Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX), SIZE_PX) is None


def test_magnification_is_the_root_of_the_area_ratio():
    recorded = np.array([[119.5, 89.5], [20.0, 30.0], [200.0, 150.0], [5.0, 5.0]])
    found = BARREL.magnification(BARREL.undistort(recorded))
    for pixel, side in zip(recorded, found, strict=True):
        corners = BARREL.undistort(pixel + 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
        area = abs(cv2.contourArea(corners.astype(np.float32)))
        assert side == pytest.approx(np.sqrt(area / 0.04), rel=0.01)
    assert found[0] == pytest.approx(1.0, abs=1e-3)
    assert found[-1] > 1.3
