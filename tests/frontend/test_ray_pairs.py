"""Matched directions of two pictures."""

from __future__ import annotations

import cv2
import numpy as np

from frontend.camera import Camera
from frontend.ray_pairs import LEAST_MATCHES, RayPair, ray_pairs

CAMERA = Camera(focal_px=(200.0, 200.0), center_px=(119.5, 89.5), size_px=(240, 180))


def detail(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(
        rng.normal(size=(60, 80)).astype(np.float32), (240, 180), interpolation=cv2.INTER_CUBIC
    )
    return np.clip(128 + 50 * coarse, 0, 255).astype(np.uint8)


def test_a_turn_about_the_centre_turns_the_rays():
    about = cv2.getRotationMatrix2D(CAMERA.center_px, -10.0, 1.0)  # clockwise on the screen
    first = detail(1)
    ((k, pair),) = ray_pairs([first, None, cv2.warpAffine(first, about, CAMERA.size_px)], CAMERA)
    assert k == 2
    assert len(pair) >= LEAST_MATCHES
    turn = np.radians(10.0)
    expected = pair.i_ray[:, :2] @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    assert np.median(np.abs(pair.j_ray[:, :2] - expected)) < 1 / CAMERA.focal_px[0]


def test_pictures_of_other_places_have_no_matches():
    assert ray_pairs([detail(1), detail(2)], CAMERA) == []
    assert ray_pairs([None, detail(2)], CAMERA) == []
    assert ray_pairs([], CAMERA) == []


def test_wrong_matches_are_left_out():
    rng = np.random.default_rng(3)
    i_ray = np.column_stack([rng.uniform(-0.6, 0.6, (100, 2)), np.ones(100)])
    j_ray = i_ray + [0.1, 0.02, 0.0]
    j_ray[:30, :2] = rng.uniform(-0.6, 0.6, (30, 2))
    kept = RayPair(i_ray, j_ray).consistent(3e-3)
    right = np.isclose(kept.j_ray - kept.i_ray, [0.1, 0.02, 0.0]).all(axis=1)
    assert right.sum() >= 65
    assert (~right).sum() <= 5
    assert len(kept.spread(10)) == 10
    assert len(kept.spread(300)) == 300
