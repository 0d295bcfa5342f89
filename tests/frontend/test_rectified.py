"""Features seen through a lens that bends lie where an ideal one would have them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig
from frontend.rectified import rectifier

SIZE_PX = (240, 180)
FOCAL_PX = 143.0
CENTER_PX = ((SIZE_PX[0] - 1) / 2, (SIZE_PX[1] - 1) / 2)
BARREL = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, (-0.28, 0.07, 0.0, 0.0))
ROUND = 60
"""Pixels of the ideal picture beyond each border of the recorded one."""


def ideal_picture(seed: int) -> np.ndarray:
    """Smooth blotches of 2 to 6 px, ``ROUND`` px larger on each side."""
    rng = np.random.default_rng(seed)
    height, width = SIZE_PX[1] + 2 * ROUND, SIZE_PX[0] + 2 * ROUND
    layers = [
        cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma) * sigma for sigma in (1.5, 3.0)
    ]
    picture = sum(layers)
    return np.clip(128 + 60 * picture / picture.std(), 0, 255).astype(np.uint8)


def recorded_by(camera: Camera, ideal: np.ndarray) -> np.ndarray:
    """What the lens makes of it."""
    u, v = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    at = camera.undistort(np.column_stack([u.ravel(), v.ravel()])) + ROUND
    x, y = at.astype(np.float32).T.reshape(2, SIZE_PX[1], SIZE_PX[0])
    return cv2.remap(ideal, x, y, cv2.INTER_CUBIC)


def found_and_true(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 2) of a recorded picture and the nearest one of the ideal picture, at most 1 px away."""
    ideal = ideal_picture(seed)
    found = Extractor()(recorded_by(BARREL, ideal), BARREL).pixel
    large = (ideal.shape[1], ideal.shape[0])
    center = (CENTER_PX[0] + ROUND, CENTER_PX[1] + ROUND)
    everything = Extractor(FeatureConfig(max_features=4000))
    true = everything(ideal, Camera((FOCAL_PX, FOCAL_PX), center, large)).pixel - ROUND
    distance, nearest = cKDTree(true).query(found)
    return found[distance < 1.0], true[nearest[distance < 1.0]]


def test_features_do_not_move_outwards_or_inwards_with_the_bend():
    pairs = [found_and_true(seed) for seed in range(4)]
    found, true = (np.concatenate(side) for side in zip(*pairs, strict=True))
    off, away = found - true, true - CENTER_PX
    far = np.linalg.norm(away, axis=1) > 80
    assert far.sum() > 200
    outwards = np.sum(off * away, axis=1)[far] / np.linalg.norm(away, axis=1)[far]
    assert abs(outwards.mean()) < 0.02
    assert np.median(np.linalg.norm(off, axis=1)) < 0.2


def test_nothing_is_found_where_nothing_was_recorded():
    pixel = Extractor()(recorded_by(BARREL, ideal_picture(5)), BARREL).pixel
    shown = BARREL.project(BARREL.rays(pixel))
    assert len(pixel) > 100
    assert (shown > -1).all()
    assert (shown < np.array(SIZE_PX)).all()
    # Beyond where a picture of the same size would have ended, too.
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
def test_a_lens_that_cannot_be_does_no_harm(distortion: tuple[float, ...]):
    camera = Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX, distortion)
    pixel = Extractor()(recorded_by(BARREL, ideal_picture(8)), camera).pixel
    assert np.isfinite(pixel).all()


def test_an_ideal_lens_needs_nothing():
    assert rectifier(Camera((FOCAL_PX, FOCAL_PX), CENTER_PX, SIZE_PX), SIZE_PX) is None


def test_magnification_is_that_of_an_area():
    recorded = np.array([[119.5, 89.5], [20.0, 30.0], [200.0, 150.0], [5.0, 5.0]])
    found = BARREL.magnification(BARREL.undistort(recorded))
    for pixel, side in zip(recorded, found, strict=True):
        corners = BARREL.undistort(pixel + 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
        area = abs(cv2.contourArea(corners.astype(np.float32)))
        assert side == pytest.approx(np.sqrt(area / 0.04), rel=0.01)
    assert found[0] == pytest.approx(1.0, abs=1e-3)
    assert found[-1] > 1.3
