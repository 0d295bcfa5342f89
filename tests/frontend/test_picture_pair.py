"""Registration of two pictures in one call, and its errors."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from frontend import Registration, register_pictures, transfer
from tests.frontend.floor_pairs import CAMERA, pair, texture, true_homography

WIDTH, HEIGHT = CAMERA.size_px


def test_the_homography_takes_the_second_picture_to_the_first():
    rng = np.random.default_rng(5)
    H = true_homography(CAMERA, *pair(rng, 1.0, 1.0, 0.05))
    second = texture(rng, WIDTH, HEIGHT)
    first = cv2.warpPerspective(second, H, CAMERA.size_px)
    found = register_pictures(first, second, CAMERA)
    assert isinstance(found, Registration)
    assert found.ok, found.reason
    error = transfer(found.i_H_j, CAMERA.corners_px) - transfer(H, CAMERA.corners_px)
    assert np.abs(error).max() < 1.0


@pytest.mark.parametrize(
    ("second", "error", "message"),
    [
        (np.zeros((HEIGHT, WIDTH)), TypeError, "expected an array of uint8, .*, got float64"),
        (np.zeros((HEIGHT, WIDTH), np.uint16), TypeError, "expected an array of uint8, .*, got uint16"),
        (np.zeros((HEIGHT, WIDTH, 4), np.uint8), ValueError, r"got shape \(240, 320, 4\)"),
        (np.zeros((WIDTH, HEIGHT), np.uint8), ValueError, "^second: expected a picture of 240 rows"),
        ("floor.png", TypeError, "expected an array of uint8, .*, got str"),
    ],
)
def test_other_arrays_are_refused(second, error, message):
    picture = np.zeros((HEIGHT, WIDTH), np.uint8)
    with pytest.raises(error, match=message):
        register_pictures(picture, second, CAMERA)
