"""SIFT of photographs: positions, scales, contrast, and its likeness to OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.detections import Detections
from frontend.features import Extractor, FeatureConfig, Features
from frontend.gradient_histograms import descriptors
from frontend.matching import match
from frontend.points import Points
from frontend.scale_space import ScaleSpace
from tests.frontend.floor_pairs import texture

Picture = NDArray[np.uint8]


def blob(x: float, y: float, sigma: float, contrast: float = 80.0) -> Picture:
    """A Gaussian blob on a picture of 90 x 70 pixels."""
    column, row = np.meshgrid(np.arange(90), np.arange(70))
    rise = contrast * np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * sigma**2))
    return np.rint(100 + rise).astype(np.uint8)


def features(picture: Picture, limit: int = 600) -> Features:
    space = ScaleSpace.of(picture)
    every = space.keypoints()
    attributes = np.stack([every.size_px, every.response])
    chosen = Detections.of(every.pixel, attributes, (picture.shape[1], picture.shape[0])).strongest(limit)
    return Features(Points.alike(every[chosen].pixel), descriptors(space, every[chosen]))


@pytest.mark.parametrize("sigma", [3.0, 5.0, 9.0])
@pytest.mark.parametrize("contrast", [80.0, -60.0])
def test_a_gaussian_blob_is_found_in_its_place_and_size(sigma: float, contrast: float) -> None:
    """The difference of Gaussians is extreme where their blur is that of the blob, less a layer's half."""
    found = ScaleSpace.of(blob(44.3, 33.6, sigma, contrast)).keypoints()
    best = int(np.argmax(found.response))
    np.testing.assert_allclose(found.pixel[best], [44.3, 33.6], atol=0.02 * sigma)
    assert found.size_px[best] / 2 == pytest.approx(sigma * 2 ** (-1 / 6), rel=0.05)


def test_faint_blobs_and_edges_are_left_out() -> None:
    assert len(ScaleSpace.of(blob(44.0, 33.0, 4.0, 80.0)).keypoints()) > 0
    assert len(ScaleSpace.of(blob(44.0, 33.0, 4.0, 2.0)).keypoints()) == 0
    edge = np.where(np.arange(90) < 40, 60, 160).astype(np.uint8)
    assert len(ScaleSpace.of(np.tile(edge, (70, 1))).keypoints()) == 0


def test_keypoints_and_descriptions_are_those_of_opencv() -> None:
    picture = texture(np.random.default_rng(2), 320, 240, 3.0)
    sift = cv2.SIFT_create(contrastThreshold=0.01, edgeThreshold=12, enable_precise_upscale=True)
    points, theirs = sift.detectAndCompute(picture, None)
    pixel = np.asarray(cv2.KeyPoint.convert(points), dtype=float)
    ours = features(picture, 5000)
    nearest = np.linalg.norm(ours.pixel[:, None] - pixel, axis=2).min(axis=1)
    assert np.median(nearest) < 0.05
    assert np.mean(nearest < 0.3) > 0.8
    pairs = match(ours, Features(Points.alike(pixel), theirs / np.linalg.norm(theirs, axis=1)[:, None]))
    off = np.linalg.norm(ours.pixel[pairs[:, 0]] - pixel[pairs[:, 1]], axis=1)
    assert len(pairs) > 0.6 * len(ours)
    assert np.mean(off < 0.5) > 0.9


@pytest.mark.parametrize(
    ("turn_deg", "scale", "least"),
    [(37.0, 1.0, 220), (90.0, 1.0, 330), (151.0, 0.67, 90), (20.0, 0.5, 45)],
)
def test_features_match_after_turns_and_at_other_scales(turn_deg: float, scale: float, least: int) -> None:
    picture = texture(np.random.default_rng(3), 400, 400, 3.0)
    turn = cv2.getRotationMatrix2D((199.5, 199.5), turn_deg, scale)
    source = cv2.GaussianBlur(picture, (0, 0), 0.5 / scale) if scale < 1 else picture
    turned = np.asarray(cv2.warpAffine(source, turn, (400, 400), flags=cv2.INTER_CUBIC), dtype=np.uint8)
    one, other = features(picture, 400), features(turned, 400)
    pairs = match(one, other)
    off = one.pixel[pairs[:, 0]] @ turn[:, :2].T + turn[:, 2] - other.pixel[pairs[:, 1]]
    right = np.linalg.norm(off, axis=1) < 1.0
    assert right.sum() > least
    assert right.mean() > 0.85
    assert np.median(np.linalg.norm(off[right], axis=1)) < 0.1


def test_points_near_the_border_do_not_see_beyond_it() -> None:
    """The same place in the middle of a larger picture is described alike, but for what is cut off."""
    whole = texture(np.random.default_rng(4), 300, 200, 3.0)
    cut = np.ascontiguousarray(whole[:, :200])
    pairs = match(features(whole, 2000), found := features(cut, 2000))
    near = found.pixel[pairs[:, 1], 0] > 185
    assert near.sum() > 10
    off = features(whole, 2000).pixel[pairs[:, 0]] - found.pixel[pairs[:, 1]]
    assert np.mean(np.linalg.norm(off[near], axis=1) < 0.5) > 0.9


def test_mask_and_features_of_a_large_picture() -> None:
    picture = texture(np.random.default_rng(5), 700, 300)
    camera = Camera((700.0, 700.0), (349.5, 149.5), (700, 300))
    mask = np.zeros((300, 700), np.uint8)
    mask[:, :350] = 255
    extract = Extractor(FeatureConfig(max_features=300))
    seen, nothing = extract(picture, camera, mask), extract(picture, camera, np.zeros_like(mask))
    assert 100 < len(seen) <= 300
    assert (seen.pixel[:, 0] < 352).all()
    np.testing.assert_allclose(np.linalg.norm(seen.descriptor, axis=1), 1.0, atol=1e-5)
    assert nothing.descriptor.shape == (0, 128)
    assert len(extract(np.full_like(picture, 90), camera)) == 0


def test_a_picture_turned_by_half_maps_features_onto_themselves() -> None:
    picture = texture(np.random.default_rng(6), 503, 347, 3.0)
    one, turned = features(picture, 1000), features(np.ascontiguousarray(picture[::-1, ::-1]), 1000)
    pairs = match(one, turned)
    bias = (one.pixel[pairs[:, 0]] + turned.pixel[pairs[:, 1]] - [502, 346]) / 2
    bias = bias[np.abs(bias).max(axis=1) < 3]  # the rest are mismatches
    assert len(bias) > 300
    np.testing.assert_allclose(np.median(bias, axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(bias.mean(axis=0), 0, atol=0.015)
