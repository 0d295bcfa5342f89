"""Tones: synthetic brightness of the same points, with and without camera errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from slam.criticism.camera.camera_path import CameraPath
from slam.criticism.camera.photometric import (
    PICTURE_PATTERNS,
    SHADING_PATTERN,
    VARIANCE_PATTERNS,
    photometric_score,
)
from slam.criticism.kalman.filter_parameters import CAMERA, GAIN, GAMMA, VIGNETTING
from slam.criticism.kalman.kernel_inputs import LikelihoodScore, Perturbation
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.data_quality.pictures.bilinear_weights import COUNT
from slam.data_quality.pictures.cells import Cells
from slam.data_quality.pictures.feature_matches import FeatureMatches
from slam.data_quality.pictures.lens_distortion_map import LensDistortionMap

Array = NDArray[np.float64]

CAMERA_AT = Camera((140.8, 140.8), (87.5, 71.5), (176, 144))
DIRECTIONS = [
    *(fitted_parameter(name).perturbation for name in CAMERA),
    *(Perturbation(name, "picture", k) for k, name in enumerate(PICTURE_PATTERNS)),
]
PICTURES, POINTS = 60, 20
SPOT_PX = (120.0, 50.0)


def made(
    seed: int,
    gain: Array | None = None,
    fog: Array | None = None,
    vignetting: float = 0.0,
    gamma: Array | None = None,
    spot: float = 0.0,
    focus: Array | None = None,
) -> tuple[FeatureMatches, CameraPath]:
    """Pictures that show each other's points, one and two before."""
    rng = np.random.default_rng(seed)
    gain = np.ones(PICTURES) if gain is None else gain
    fog = np.zeros(PICTURES) if fog is None else fog
    gamma = np.ones(PICTURES) if gamma is None else gamma
    focus = np.ones(PICTURES) if focus is None else focus

    def tone(picture: NDArray[np.int64], at: Array, level: Array, detail: Array) -> Array:
        r2 = ((at - CAMERA_AT.center_px) ** 2).sum(axis=1) / (np.hypot(176, 144) / 2) ** 2
        seen = level * (gain[picture] * (1 - vignetting * r2))[:, None]
        seen *= 1 - spot * np.exp(-((at - SPOT_PX) ** 2).sum(axis=1) / (2 * 25.0**2))[:, None]
        seen = seen * (1 - fog[picture])[:, None] + 170 * fog[picture][:, None]
        seen = 255.0 * (seen / 255.0) ** gamma[picture][:, None]
        sharp = focus[picture] * gain[picture] * (1 - fog[picture])
        local = detail * sharp * np.exp(0.05 * rng.standard_normal(len(at)))
        return np.column_stack([seen + 0.8 * rng.standard_normal(level.shape), local])

    def shown(points: int) -> tuple[list[NDArray[np.int64]], list[Array], list[Array]]:
        """Pictures, pixels and tones of points that pairs of pictures have in common."""
        ends = ([np.arange(PICTURES - s) + k * s for s in (1, 2)] for k in (0, 1))
        both = [np.concatenate(end).repeat(points) for end in ends]
        m = len(both[0])
        light = rng.uniform(60, 180, (m, 3)), rng.uniform(5, 20, m)
        at = [rng.uniform(5, 139, (m, 2)) for _ in range(2)]
        return both, at, [tone(picture, pixel, *light) for picture, pixel in zip(both, at, strict=True)]

    (i, j), pixel, tones = shown(POINTS)
    (k, n), places, light = shown(2 * POINTS)
    grey = [t[:, :3].mean(axis=1) for t in light]
    cells = Cells(k, n, places[0], places[1], np.log(grey[0] / grey[1]))
    stamps = 0.25 * np.arange(PICTURES)
    matches = FeatureMatches(
        CAMERA_AT, stamps, i, j, pixel[0], pixel[1], np.full(len(i), 0.2), tones[0], tones[1], 0,
        PICTURES, LensDistortionMap(CAMERA_AT, PICTURES, np.zeros((2, COUNT, 2)), 0.0), cells,
    )  # fmt: skip
    poses, rates = np.zeros((PICTURES, 6)), np.zeros((PICTURES, 6))
    poses[:, 2] = 1.2 + 0.1 * np.sin(stamps)
    rates[:, 0] = np.abs(np.sin(0.7 * stamps))
    certain = np.zeros((PICTURES - 1, 12, 12)), np.zeros((PICTURES, 12, 12))
    traces = np.zeros((6 * PICTURES, 0))
    span_s, inside = (stamps[0], stamps[-1]), np.full(PICTURES, True)
    return matches, CameraPath(stamps, poses, rates, 0 * rates, traces, *certain, span_s, inside)


def walk(seed: int) -> Array:
    """Of an automatic with a memory of a second."""
    kicks = np.random.default_rng(seed).standard_normal(PICTURES)
    walked = np.zeros(PICTURES)
    for k in range(1, PICTURES):
        walked[k] = np.exp(-0.25) * walked[k - 1] + np.sqrt(1 - np.exp(-0.5)) * kicks[k]
    return walked


def judged(matches: FeatureMatches, path: CameraPath) -> tuple[Array, LikelihoodScore]:
    """z of every direction alone."""
    found = photometric_score(matches, np.zeros(len(CAMERA)), path, DIRECTIONS)
    return found.score / np.sqrt(np.maximum(np.diag(found.information), 1e-12)), found


def shapes(z: Array) -> Array:
    """How far shapes that no term has stand out; of a variance less than a healthy one is nothing."""
    of_shapes = z[..., len(CAMERA) :]
    return np.where([name in VARIANCE_PATTERNS for name in PICTURE_PATTERNS], of_shapes, np.abs(of_shapes))


def test_a_steady_camera_shows_nothing() -> None:
    z = np.array([judged(*made(seed))[0] for seed in range(3)])
    assert (z[:, GAIN] < 3.5).all()
    assert shapes(z).max() < 4.0
    assert np.abs(z[:, VIGNETTING]).max() < 3.5


def test_a_dark_spot_on_the_lens_is_a_shape_of_its_own_no_vignette_and_no_exposure() -> None:
    z, _ = judged(*made(1, spot=0.25))
    assert z[len(CAMERA) + PICTURE_PATTERNS.index(SHADING_PATTERN)] > 5.0
    assert z[GAIN] < 4.0
    # A spot near the middle is all that a vignette is not.
    assert z[VIGNETTING] < 4.0
    gain = np.exp(0.05 * walk(1))
    assert judged(*made(1, gain, spot=0.25))[0][GAIN] > 8.0
    vignetted = judged(*made(1, vignetting=0.3))[0]
    assert abs(vignetted[len(CAMERA) + PICTURE_PATTERNS.index(SHADING_PATTERN)]) < 4.0


def test_fog_is_a_shape_of_its_own_and_no_exposure() -> None:
    fog = np.linspace(0.0, 0.4, PICTURES)
    z, _ = judged(*made(1, fog=fog))
    contrast = z[len(CAMERA) + PICTURE_PATTERNS.index("picture contrast ~ time")]
    assert contrast < -8.0
    assert z[GAIN] < 4.0
    assert abs(z[VIGNETTING]) < 4.0


def test_a_hunting_focus_is_random_sharpness_and_no_exposure() -> None:
    z, _ = judged(*made(1, focus=np.exp(-np.abs(0.4 * walk(1)))))
    restless = [z[len(CAMERA) + PICTURE_PATTERNS.index(name)] for name in VARIANCE_PATTERNS]
    assert restless[1] > 10.0
    assert restless[0] < 4.0
    assert max(z[GAIN], z[GAMMA]) < 4.0


def test_an_automatic_exposure_is_a_variance() -> None:
    z, found = judged(*made(2, gain=np.exp(0.05 * walk(2))))
    assert z[GAIN] > 10.0
    assert np.sqrt(found.score[GAIN] / found.information[GAIN, GAIN]) == pytest.approx(0.05, rel=0.5)


def test_a_random_gamma_is_no_random_gain() -> None:
    """It makes brighter and darker as well; contrast separates them."""
    matches, path = made(4, gamma=np.exp(0.15 * walk(4)))
    camera = np.zeros(len(CAMERA))
    z = []
    for camera[GAMMA] in (0.0, 0.15**2):
        found = photometric_score(matches, camera, path, DIRECTIONS)
        z.append(found.score[GAIN] / np.sqrt(found.information[GAIN, GAIN]))
    assert z[0] > 10.0
    assert z[1] < 3.5


def test_what_lies_farther_out_is_darker_and_no_matter_of_height() -> None:
    """Parameters with the vignetting show no further trend."""
    matches, path = made(5, vignetting=0.3)
    camera = np.zeros(len(CAMERA))
    camera[VIGNETTING] = 0.3
    found = photometric_score(matches, camera, path, DIRECTIONS)
    z = found.score / np.sqrt(np.maximum(np.diag(found.information), 1e-12))
    assert shapes(z).max() < 4.0
    assert z[GAIN] < 3.5


def test_dark_corners_are_vignetting_at_its_size() -> None:
    z, found = judged(*made(3, vignetting=0.1))
    assert z[VIGNETTING] > 5.0
    assert found.score[VIGNETTING] / found.information[VIGNETTING, VIGNETTING] == pytest.approx(0.1, rel=0.25)
