"""Pictures laid over each other by the floor."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from frontend.camera import Camera
from slam.data_quality.pictures.overlaid import pixels


def test_pixels_of_two_lenses_with_the_same_numbers_differ_as_opencv_has_them() -> None:
    brown = Camera((300.0, 310.0), (158.0, 121.0), (320, 240), distortion=(-0.1, 0.02, 0.001, 0.0))
    fisheye = replace(brown, lens="equidistant")
    K, lens = brown.matrix, np.array(brown.distortion)
    at = np.stack(np.meshgrid(np.arange(160), np.arange(120)), axis=-1).reshape(-1, 1, 2) * 2.0 + 0.5
    by_brown = cv2.undistortPoints(at, K, lens, P=K)[:, 0]
    by_fisheye = cv2.fisheye.undistortPoints(at, K, lens, P=K)[:, 0]
    np.testing.assert_allclose(pixels((120, 160), brown), by_brown, atol=0.02)
    np.testing.assert_allclose(pixels((120, 160), fisheye), by_fisheye, atol=0.02)
    assert np.abs(by_brown - by_fisheye).max() > 1.0
