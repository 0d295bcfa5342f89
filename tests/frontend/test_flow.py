"""Optical flow from a keyframe: exact under turns, climbs and light, and silent where it could be wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig
from frontend.flow import FlowTemplate
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.motions import Expectation
from frontend.registration import Registration
from tests.frontend.floor_pairs import CAMERA, FISHY, body, texture, true_homography

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

HEIGHT_M, GRAIN = 1.0, 3
HERE = body(0.0, 0.0, HEIGHT_M)
"""The keyframe's pose. Its picture is the middle of the floor, which has ``GRAIN`` pixels a pixel of it."""


@cache
def floor() -> Image:
    return cv2.GaussianBlur(texture(np.random.default_rng(0), 640 * GRAIN, 520 * GRAIN), (0, 0), 2.0)


def picture(w_T_b: Array, seed: int, camera: Camera = CAMERA, noise: float = 2.0) -> Image:
    """Return the grey picture of the floor from a pose, with noise."""
    u, v = np.meshgrid(*map(np.arange, camera.size_px))
    ideal = camera.undistort(np.column_stack([u.ravel(), v.ravel()]))
    there = transfer(true_homography(camera, HERE, w_T_b), ideal) + [160.0, 140.0]
    x, y = (there * GRAIN).astype(np.float32).T.reshape(2, *camera.size_px[::-1])
    seen = cv2.remap(floor(), x, y, cv2.INTER_CUBIC) + np.random.default_rng(seed).normal(0, noise, x.shape)
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def template(camera: Camera = CAMERA, noise: float = 2.0) -> FlowTemplate:
    image = picture(HERE, 0, camera, noise)
    return FlowTemplate.of(image, Extractor(FeatureConfig())(image, camera), camera)


@pytest.fixture(scope="module")
def keyframe() -> FlowTemplate:
    return template()


def corners(camera: Camera = CAMERA) -> Array:
    return camera.undistort(camera.corners_px)


def followed(
    keyframe: FlowTemplate,
    image: Image,
    expected_from: Array,
    off_px: float = 3.0,
    mask: Image | None = None,
) -> Registration | None:
    """Follow a picture that is expected ``off_px`` from where a pose has it."""
    camera = keyframe.frame.camera
    expected_px = transfer(true_homography(camera, HERE, expected_from), corners(camera)) + off_px * 0.7
    expected = Expectation(expected_px, 0.5)
    return keyframe.register(4, 5, image, mask, expected, HomographyConfig(), GateConfig())


def error_px(found: Registration, w_T_b: Array, camera: Camera = CAMERA) -> Array:
    """Return the errors (8,) of the transferred corners."""
    truth = true_homography(camera, HERE, w_T_b)
    return (transfer(found.i_H_j, corners(camera)) - transfer(truth, corners(camera))).ravel()


@pytest.mark.parametrize(
    "camera",
    [pytest.param(CAMERA, id="ideal lens", marks=pytest.mark.slow), pytest.param(FISHY, id="distorted lens")],
)
def test_covariances_hold_what_the_homographies_are_off(camera: Camera) -> None:
    noise, nees, rng = 10.0, [], np.random.default_rng(1)
    keyframe = template(camera, noise)
    for n in range(30):
        there = body(*rng.normal(0, 0.06, 2), rng.uniform(0.9, 1.1), *rng.normal(0, 0.05, 3))
        found = followed(keyframe, picture(there, n + 1, camera, noise), there)
        assert found is not None
        error = error_px(found, there, camera)
        assert np.abs(error).max() < 0.4

        nees.append(error @ np.linalg.solve(found.corner_covariance, error))
    # All share the keyframe's noise, so the mean scatters more than that of independent pictures.
    assert 0.7 < np.mean(nees) / 8 < 1.6


@pytest.mark.parametrize(("yaw", "ratio"), [(0.6, 1.0), (3.0, 1.0), (0.0, 1.3), (-1.5, 0.8)])
def test_a_predicted_turn_or_climb_costs_no_accuracy(
    keyframe: FlowTemplate, yaw: float, ratio: float
) -> None:
    there = body(0.02, -0.03, ratio * HEIGHT_M, yaw)
    found = followed(keyframe, picture(there, 1), there)
    assert found is not None
    assert np.abs(error_px(found, there)).max() < 0.3


def test_a_wrong_prediction_is_corrected_or_left_to_features(keyframe: FlowTemplate) -> None:
    there = body(0.03, 0.02, HEIGHT_M, 0.1)
    image = picture(there, 1)
    for off_px in (1.0, 6.0, 12.0):
        found = followed(keyframe, image, there, off_px)
        assert found is not None
        assert np.abs(error_px(found, there)).max() < 0.2
    for off_px in (30.0, 60.0, 150.0, 1e5):
        assert followed(keyframe, image, there, off_px) is None


@pytest.mark.parametrize(
    "light",
    [
        pytest.param(lambda p: 0.7 * p, id="shorter exposure"),
        pytest.param(lambda p: 0.5 * p + 80, id="haze"),
        pytest.param(lambda p: 255 * (p / 255) ** 1.5, id="gamma"),
        pytest.param(lambda p: p * np.linspace(0.5, 1, p.shape[1]), id="shade to one side"),
    ],
)
def test_light_displaces_nothing(keyframe: FlowTemplate, light) -> None:
    there = body(0.05, 0.04, HEIGHT_M, 0.05)
    image = np.clip(light(picture(there, 1).astype(float)), 0, 255).astype(np.uint8)
    found = followed(keyframe, image, there)
    assert found is not None
    assert np.abs(error_px(found, there)).max() < 0.2


def test_two_motions_are_left_to_features(keyframe: FlowTemplate) -> None:
    """The left half stands still in the picture, like a landing gear, and the floor moves."""
    there = body(0.06, 0.05, HEIGHT_M)
    image = picture(there, 1)
    assert followed(keyframe, image, there) is not None
    image[:, :130] = picture(HERE, 2)[:, :130]
    assert followed(keyframe, image, there) is None
    assert followed(keyframe, image, HERE) is None


def test_a_covered_floor_is_left_to_features(keyframe: FlowTemplate) -> None:
    there = body(0.05, 0.0, HEIGHT_M)
    image = picture(there, 1)
    image[:, 100:] = 128
    assert followed(keyframe, image, there) is None
    assert followed(keyframe, np.full_like(image, 90), there) is None
    assert followed(keyframe, texture(np.random.default_rng(9), 320, 240), there) is None


def test_masked_pixels_are_not_followed(keyframe: FlowTemplate) -> None:
    """What moves is masked: the floor alone is left."""
    there = body(0.06, 0.05, HEIGHT_M)
    image, mask = picture(there, 1), np.full(CAMERA.size_px[::-1], 255, np.uint8)
    image[:, :130], mask[:, :140] = picture(HERE, 2)[:, :130], 0
    found = followed(keyframe, image, there, mask=mask)
    assert found is not None
    assert np.abs(error_px(found, there)).max() < 0.3
    assert followed(keyframe, image, there, mask=np.zeros_like(mask)) is None


def test_large_and_colour_pictures_are_followed_at_the_full_size_s_scale() -> None:
    large = replace(CAMERA, focal_px=(900.0, 915.0), center_px=(484.0, 353.5), size_px=(960, 720))

    def enlarged(w_T_b: Array, seed: int) -> Image:
        size = large.size_px
        return cv2.cvtColor(
            cv2.resize(picture(w_T_b, seed), size, interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2BGR
        )

    image, there = enlarged(HERE, 0), body(0.03, 0.02, HEIGHT_M, 0.1)
    keyframe = FlowTemplate.of(image, Extractor(FeatureConfig())(image, large), large)
    found = followed(keyframe, enlarged(there, 1), there)
    assert found is not None
    assert np.abs(error_px(found, there, large)).max() < 0.6  # of pixels three times as fine
