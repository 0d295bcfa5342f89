"""What bends the light of one place of the picture is found there; what a lens does as a whole is not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.homography import transfer
from slam.criticism.camera.lens import LENS_MAP_PATTERN, WARPS
from slam.criticism.camera.photometric import PICTURE_PATTERNS
from slam.criticism.camera.reprojection import reprojection_score
from slam.criticism.kalman.filter_parameters import CAMERA, TILT_X, filter_parameters_of
from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.kalman.record import record_of
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.data_quality.pictures.bilinear_weights import bilinear_weights, places
from slam.data_quality.pictures.feature_matches import match_all_pictures
from slam.data_quality.pictures.lens_distortion_map import PairMatches, lens_distortion_map
from slam.simulation.model import load_model
from tests.slam.criticism.camera.camera_flight import camera_flight

Array = NDArray[np.float64]

AT = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))
DROP_PX, REACH_PX = np.array([120.0, 45.0]), 17.0
PICTURES, POINTS, NOISE_PX = 160, 24, 0.15


def drop(pixel: Array) -> Array:
    """(m, 2) px, at most 2: a lens of its own off the middle."""
    off = pixel - DROP_PX
    near = np.exp(-(off**2).sum(axis=1, keepdims=True) / (2 * REACH_PX**2))
    return np.asarray(2.0 * np.sqrt(np.e) / REACH_PX * near * off)


def radial(pixel: Array) -> Array:
    """(m, 2) px of a barrel."""
    ray = (pixel - AT.center_px) / AT.focal_px
    return np.asarray(0.05 * (ray**2).sum(axis=1, keepdims=True) * ray * AT.focal_px)


def askew(pixel: Array) -> Array:
    """(m, 2) px of a camera that leans."""
    x, y = ((pixel - AT.center_px) / AT.focal_px).T
    return np.asarray(0.04 * np.column_stack([1 + x**2, x * y]) * AT.focal_px)


def nothing(pixel: Array) -> Array:
    return np.zeros_like(pixel)


def flown(bend, seed: int) -> PairMatches:
    """Pairs of pictures that move by up to a third and turn a little, seen through a lens that bends."""
    rng = np.random.default_rng(seed)
    parts = []
    for i, j in ((j - s, j) for j in range(PICTURES) for s in (1, 2) if j >= s):
        turn, (right, down) = rng.normal(0, 0.1), rng.uniform(-45, 45, 2)
        H = np.array([[np.cos(turn), -np.sin(turn), right], [np.sin(turn), np.cos(turn), down], [0, 0, 1.0]])
        H[2, :2] = rng.normal(0, 1e-4, 2)
        b = rng.uniform(0, 1, (POINTS, 2)) * AT.size_px
        a = transfer(H, b)
        a, b = (p + bend(p) + rng.normal(0, NOISE_PX, p.shape) for p in (a, b))
        inside = ((a > 0) & (a < AT.size_px)).all(axis=1)
        if inside.sum() >= 8:
            parts.append((np.full(inside.sum(), len(parts)), i, j, a[inside], b[inside]))
    pair = np.concatenate([p[0] for p in parts])
    i, j = (np.array([p[k] for p in parts])[pair] for k in (1, 2))
    a, b = (np.concatenate([p[k] for p in parts]) for k in (3, 4))
    fits = [cv2.findHomography(p[4], p[3], 0)[0] for p in parts]
    return PairMatches(pair, i, j, a, b, np.full(len(a), NOISE_PX), np.stack(fits))


def test_a_drop_is_mapped_where_it_is_and_as_it_is():
    lens_distortion = lens_distortion_map(AT, PICTURES, flown(drop, 1))
    at = places(AT)
    true, found = drop(at), lens_distortion.halves * lens_distortion.size_px
    well_inside = ((at > 10) & (at < np.array(AT.size_px) - 10)).all(axis=1)
    for half in found:
        assert np.linalg.norm(half[well_inside] - true[well_inside], axis=1).max() < 0.7
        assert np.sqrt(np.mean((half[well_inside] - true[well_inside]) ** 2)) < 0.15
    assert np.hypot(*true.T).max() > 1.5


def test_each_half_is_predicted_by_the_other():
    lens_distortion = lens_distortion_map(AT, PICTURES, flown(nothing, 1))
    lens_distortion = replace(
        lens_distortion, halves=np.stack([np.full((len(places(AT)), 2), k) for k in (1.0, 2.0)])
    )
    pixel, earlier = np.full((PICTURES, 2), 50.0), np.arange(PICTURES)
    reported = lens_distortion.predicted_by_others(pixel, earlier)
    assert set(reported[:, 0]) == {1.0, 2.0}
    assert reported[0, 0] == 2.0
    assert np.mean(reported[:, 0] == 2.0) == 0.5


@pytest.mark.parametrize("bend", [nothing, radial, askew])
def test_what_a_lens_does_as_a_whole_is_no_dent(bend):
    lens_distortion = lens_distortion_map(AT, PICTURES, flown(bend, 2))
    assert lens_distortion.size_px < 0.08
    first, second = lens_distortion.halves.reshape(2, -1)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.5


def test_nodes_weigh_to_one_and_reproduce_what_is_linear():
    pixel = np.random.default_rng(3).uniform(0, 1, (50, 2)) * (np.array(AT.size_px) - 1)
    np.testing.assert_allclose(bilinear_weights(AT, pixel) @ places(AT), pixel)
    np.testing.assert_allclose(np.asarray(bilinear_weights(AT, pixel).sum(axis=1)).ravel(), 1.0)


@pytest.mark.slow
def test_a_drop_is_not_taken_for_a_camera_that_leans():
    """The map of the lens explains more than any tilt does."""
    flight = camera_flight({}, 6)
    matches, parameters = match_all_pictures([flight])[0], filter_parameters_of(load_model("nominal"))
    assert matches is not None
    a, b = (pixel + drop(pixel) for pixel in (matches.pixel_i, matches.pixel_j))
    pairs, pair = np.unique(np.column_stack([matches.earlier, matches.later]), axis=0, return_inverse=True)
    fits = np.stack([cv2.findHomography(b[pair == k], a[pair == k], 0)[0] for k in range(len(pairs))])
    pair_matches = PairMatches(pair.ravel(), matches.earlier, matches.later, a, b, matches.std_px, fits)
    bent = replace(
        matches,
        pixel_i=a,
        pixel_j=b,
        lens_distortion=lens_distortion_map(matches.camera, len(matches.stamps_s), pair_matches),
    )
    directions = [
        *(fitted_parameter(CAMERA[k]).perturbation for k in (TILT_X, TILT_X + 1)),
        Perturbation(LENS_MAP_PATTERN, "picture", len(PICTURE_PATTERNS) + WARPS.index(LENS_MAP_PATTERN)),
    ]
    found = reprojection_score(record_of(flight), bent, parameters, directions)
    information, score = found.information[:2, :2], found.score[:2]
    lens = float(found.score[2] ** 2 / found.information[2, 2])
    tilt = float(score @ np.linalg.solve(information, score))
    assert tilt > 25.0
    assert lens > 2.0 * tilt
