"""Lenses of ``CameraInfo``: the camera agrees with OpenCV's own models within the error it states."""

from __future__ import annotations

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from frontend.camera import Camera
from slam.io.recordings.ros.lens import UnknownLensError, lens_of

SIZE_PX = (640, 480)
K = np.array([[420.0, 0, 330], [0, 425, 235], [0, 0, 1]])
PLUMB_BOB = (-0.28, 0.09, 0.001, -0.0005, -0.01)
RATIONAL = (0.32, -0.02, 0.0004, -0.0003, 0.001, 0.66, 0.03, -0.002)
FISHEYE = (-0.02, 0.004, -0.002, 0.0003)


def info(model: str, coefficients: tuple[float, ...]) -> SimpleNamespace:
    return SimpleNamespace(
        k=K.ravel(), d=np.array(coefficients), distortion_model=model, width=SIZE_PX[0], height=SIZE_PX[1]
    )


def rays() -> np.ndarray:
    """Directions (n, 3) over the whole picture, of which those outside are left out by the test."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 41), np.linspace(-0.9, 0.9, 31))
    return np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])


def projected(lens) -> np.ndarray:
    return Camera(lens.focal_px, lens.center_px, SIZE_PX, lens.distortion, lens=lens.model).project(rays())


def by_opencv(model: str, coefficients: tuple[float, ...]) -> np.ndarray:
    zero = np.zeros(3)
    if model == "equidistant":
        return cv2.fisheye.projectPoints(rays()[:, None], zero, zero, K, np.array(coefficients))[0][:, 0]
    return cv2.projectPoints(rays(), zero, zero, K, np.array(coefficients))[0][:, 0]


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("plumb_bob", PLUMB_BOB), ("rational_polynomial", RATIONAL), ("equidistant", FISHEYE)],
)
def test_the_lens_agrees_with_opencv_within_the_error_it_states(model, coefficients):
    lens, notes = lens_of(info(model, coefficients), SIZE_PX)
    expected = by_opencv(model, coefficients)
    inside = ((expected >= 0) & (expected <= np.subtract(SIZE_PX, 1))).all(axis=1)
    error_px = np.linalg.norm(projected(lens) - expected, axis=1)[inside].max()
    stated = re.search(r"up to ([0-9.]+) px", " ".join(map(str, notes)))
    # The tangential part is taken as it is, which adds a few hundredths of a pixel.
    assert inside.sum() > 200
    assert error_px < (1.1 * float(stated[1]) + 0.05 if stated else 1e-3)
    assert error_px < 1.0


@pytest.mark.parametrize(
    ("model", "coefficients", "why"),
    [
        ("thin_prism", (0.1,) * 4, "lens model 'thin_prism' with 4 coefficients is not known"),
        ("equidistant", (0.1,) * 3, "lens model 'equidistant' with 3 coefficients"),
        ("equidistant", (-0.3, 0.0, 0.0, 0.0), "too wide or folds back"),
        ("rational_polynomial", (-0.9, 0, 0, 0, 0, 0, 0.1, 0), "too wide or folds back"),
    ],
)
def test_a_lens_that_no_camera_describes_is_refused(model, coefficients, why):
    with pytest.raises(UnknownLensError, match=why):
        lens_of(info(model, coefficients), SIZE_PX)


def test_a_size_of_another_aspect_is_refused():
    with pytest.raises(UnknownLensError, match="have 300 x 300 px, but CameraInfo is for 640 x 480"):
        lens_of(info("plumb_bob", PLUMB_BOB), (300, 300))


@pytest.mark.parametrize("name", ["equidistant", "fisheye"])
def test_a_fisheye_is_taken_as_it_is(name):
    """Up to 75 degrees from the axis, where a pinhole with radial distortion has large errors."""
    focal_px = 300.0
    matrix = np.array([[focal_px, 0, 319.5], [0, focal_px, 239.5], [0, 0, 1]])
    wide = SimpleNamespace(
        k=matrix.ravel(), d=np.array(FISHEYE), distortion_model=name, width=SIZE_PX[0], height=SIZE_PX[1]
    )
    lens, notes = lens_of(wide, SIZE_PX)
    assert notes == []
    assert lens.distortion == FISHEYE
    camera = Camera(lens.focal_px, lens.center_px, SIZE_PX, lens.distortion, lens=lens.model)
    u, v = np.meshgrid(np.linspace(0, 639, 33), np.linspace(0, 479, 25))
    pixel = np.column_stack([u.ravel(), v.ravel()])
    by_opencv = cv2.fisheye.undistortPoints(pixel[:, None], matrix, np.array(FISHEYE))[:, 0]
    rays = camera.rays(camera.undistort(pixel))
    np.testing.assert_allclose(rays[:, :2], by_opencv, atol=1e-5)
    assert np.degrees(np.arctan(np.linalg.norm(by_opencv, axis=1).max())) > 74
