"""Alignment by grey levels over a floor of lines: two-sided consistency, and silence along the lines."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.alignment import AlignmentTemplate, Prediction
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import Registration
from tests.frontend.floor_pairs import CAMERA, body, true_homography

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GRAIN, FINE = 4, 3
"""Pixels of the floor for a pixel of the keyframe, and rays for a pixel along each side."""
OPEN_PX = 30.0
"""Standard deviation between those of directions that lines show and those that they leave open."""
PARALLEL, CROSSING = (60, 130, 215, 270), (85, 190)


def floor(across: tuple[int, ...] = CROSSING) -> Image:
    """Return a floor around the keyframe's picture, with lines along y and some ``across``."""
    grey = np.full((480 * GRAIN, 560 * GRAIN), 96, np.uint8)
    for at in PARALLEL:
        grey[:, (at + 120) * GRAIN : (at + 124) * GRAIN] = 224
    for at in across:
        grey[(at + 120) * GRAIN : (at + 124) * GRAIN] = 224
    return grey


def picture(lines: Image, w_T_b: Array, seed: int, gain: float = 1.0) -> Image:
    """Return the noisy picture from a pose; each pixel is the mean over its area."""
    u, v = (np.arange(size * FINE) for size in CAMERA.size_px)
    pixel = (np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2) + 0.5) / FINE - 0.5
    there = (transfer(true_homography(CAMERA, HERE, w_T_b), pixel) + 120.5) * GRAIN - 0.5
    x, y = there.astype(np.float32).T.reshape(2, len(v), len(u))
    light = cv2.resize(cv2.remap(lines, x, y, cv2.INTER_LINEAR), CAMERA.size_px, interpolation=cv2.INTER_AREA)
    noisy = gain * light + np.random.default_rng(seed).normal(0, 1.5, light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


HERE = body(0.0, 0.0, 1.0)


def aligned(
    image: Image,
    w_T_b: Array,
    lines: Image,
    off_px: tuple[float, float] = (0.0, 0.0),
    std_px: tuple[float, float] = (3.0, 3.0),
) -> Registration | None:
    """Align a picture with that from `HERE`, from a start ``off_px`` beside the truth."""
    shift = np.array([[1, 0, off_px[0]], [0, 1, off_px[1]], [0, 0, 1.0]])
    here, there = (AlignmentTemplate.of(each, None, CAMERA) for each in (picture(lines, HERE, 0), image))
    predicted = Prediction(shift @ true_homography(CAMERA, HERE, w_T_b), np.diag(np.square(std_px)))
    return here.register(4, 5, there, predicted, 0.5, HomographyConfig(), GateConfig())


def whitened(found: Registration, w_T_b: Array) -> Array:
    """Return the errors in the directions that are not open, in standard deviations."""
    off = transfer(found.i_H_j, CAMERA.corners_px) - transfer(
        true_homography(CAMERA, HERE, w_T_b), CAMERA.corners_px
    )
    variance, axes = np.linalg.eigh(found.corner_covariance)
    return np.asarray((axes.T @ off.ravel() / np.sqrt(variance))[variance < OPEN_PX**2])


def poses(count: int) -> list[Array]:
    rng = np.random.default_rng(1)
    return [
        body(*rng.normal(0, 0.06, 2), 1.0 + rng.normal(0, 0.01), *rng.normal(0, 0.01, 3))
        for _ in range(count)
    ]


def test_errors_agree_with_the_covariance_both_ways():
    lines = floor()
    squares = []
    for seed, w_T_b in enumerate(poses(6), start=1):
        found = aligned(picture(lines, w_T_b, seed), w_T_b, lines, (2.0, -2.0))
        assert found is not None
        squares.append(whitened(found, w_T_b) ** 2)
    assert 0.1 < np.mean(np.concatenate(squares)) < 1.6


def test_along_parallel_lines_the_prediction_stays_and_the_covariance_says_so():
    lines, w_T_b = floor(across=()), body(0.05, 0.03, 1.0)
    found = aligned(picture(lines, w_T_b, 1), w_T_b, lines, (1.5, 6.0))
    assert found is not None
    off = (transfer(found.i_H_j, CAMERA.corners_px) - transfer(
        true_homography(CAMERA, HERE, w_T_b), CAMERA.corners_px
    )).mean(axis=0)  # fmt: skip
    assert abs(off[0]) < 0.2
    assert off[1] == pytest.approx(6.0, abs=2.0)
    along = np.tile([0.0, 0.5], 4)
    assert np.sqrt(along @ found.corner_covariance @ along) > OPEN_PX
    across = np.tile([0.5, 0.0], 4)
    assert np.sqrt(across @ found.corner_covariance @ across) < 1.0


def test_another_exposure_changes_little():
    lines, w_T_b = floor(), body(0.04, -0.02, 1.0)
    found = aligned(picture(lines, w_T_b, 1, gain=0.7), w_T_b, lines)
    assert found is not None
    assert np.mean(whitened(found, w_T_b) ** 2) < 3.0


def test_lines_elsewhere_are_not_aligned():
    w_T_b = body(0.0, 0.0, 1.0)
    other = picture(floor(across=(20, 120, 160)), w_T_b, 1)
    assert aligned(np.ascontiguousarray(other[:, ::-1]), w_T_b, floor()) is None


def test_a_floor_without_lines_has_no_structure():
    plain = picture(np.full_like(floor(), 120), HERE, 0)
    assert not AlignmentTemplate.of(plain, None, CAMERA).is_structured
    assert AlignmentTemplate.of(picture(floor(), HERE, 0), None, CAMERA).is_structured


def test_of_equal_lines_only_the_covariance_of_the_prediction_tells_which_is_which():
    equal = np.full((480 * GRAIN, 560 * GRAIN), 96, np.uint8)
    for at in range(2, 560, 24):
        equal[:, at * GRAIN : (at + 4) * GRAIN] = 224
        equal[(at - 1) * GRAIN : (at + 3) * GRAIN] = 224
    w_T_b = body(0.02, -0.01, 1.0)
    image = picture(equal, w_T_b, 1)
    assert aligned(image, w_T_b, equal, (1.0, -1.0), (1.0, 1.0)) is not None
    assert aligned(image, w_T_b, equal, (1.0, -1.0), (1.0, 9.0)) is None


def test_a_prediction_of_unknown_place_is_not_searched():
    lines, w_T_b = floor(), body(0.03, 0.02, 1.0)
    assert aligned(picture(lines, w_T_b, 1), w_T_b, lines, std_px=(20.0, 20.0)) is None
