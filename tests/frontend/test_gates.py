"""The gates: each reason is reached, and reached by its own fault alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frontend.camera import Camera
from frontend.gates import GateConfig, local_scale, reject_reason, relative_change
from frontend.homography import HomographyFit, fit_homography
from frontend.points import Points
from tests.frontend.floor_pairs import CAMERA, Array, body, pair, true_homography

GATES = GateConfig()
WIDE = Camera((300.0, 300.0), (159.5, 119.5), (320, 240))


def good(count: int = 100, inliers: int = 60) -> tuple[HomographyFit, Array]:
    rng = np.random.default_rng(0)
    inlier = np.arange(count) < inliers
    fit = HomographyFit(np.eye(3), 0.04 * np.eye(8), inlier, 0.3)
    return fit, rng.uniform([0, 0], [319, 239], (count, 2))


def reason(fit: HomographyFit, pixel_j: Array, overlap: float = 0.8) -> str:
    return str(reject_reason(fit, pixel_j, WIDE, overlap, GATES) or "")


def test_good_fit_passes() -> None:
    assert reason(*good()) == ""


@pytest.mark.parametrize(
    ("inliers", "count", "expected"),
    [
        (14, 20, "too few inliers"),
        (15, 20, ""),
        (15, 75, ""),
        (15, 76, "outlier share above gamma_1"),
        (60, 299, ""),
        (60, 301, "outlier share above gamma_1"),
    ],
)
def test_inliers_and_gamma_1(inliers: int, count: int, expected: str) -> None:
    assert reason(*good(count, inliers)) == expected


def test_overlap() -> None:
    assert reason(*good(), overlap=0.09) == "folded or no overlap"
    assert reason(*good(), overlap=0.11) == ""


@pytest.mark.parametrize(("scale", "passes"), [(0.28, False), (0.3, True), (3.4, True), (3.6, False)])
def test_scale(scale: float, passes: bool) -> None:
    fit, pixel_j = good()
    verdict = reason(replace(fit, i_H_j=np.diag([scale, scale, 1.0])), pixel_j)
    assert verdict == ("" if passes else "implausible change of scale")


def test_crowded_inliers_are_refused_however_wide_the_outliers_lie() -> None:
    fit, pixel_j = good()
    rng = np.random.default_rng(1)
    pixel_j[:60] = [150, 100] + rng.uniform(0, 40, (60, 2))  # 1600 of 76800 px², 3 % are 2304
    assert reason(fit, pixel_j) == "inliers crowded in one place"
    pixel_j[:60] = [150, 100] + rng.uniform(0, 60, (60, 2))
    assert reason(fit, pixel_j) == ""


def test_uncertain_corner() -> None:
    fit, pixel_j = good()
    for variance in (9.7**2, np.nan, np.inf):
        covariance = 0.04 * np.eye(8)
        covariance[5, 5] = variance
        verdict = reason(replace(fit, corner_covariance=covariance), pixel_j)
        assert verdict == "homography poorly determined"
    covariance[5, 5] = 9.5**2
    assert reason(replace(fit, corner_covariance=covariance), pixel_j) == ""


def test_local_scale_is_the_ratio_of_heights_of_level_cameras() -> None:
    for ratio in (0.4, 1.0, 2.5):
        H = true_homography(CAMERA, body(0, 0, 1.0, 0.3), body(0.1, -0.2, ratio, -2.0))
        assert local_scale(H, CAMERA) == pytest.approx(ratio, rel=1e-3)


def test_random_matches_never_pass() -> None:
    """Some homography fits any matches, random ones too; the gates must see through it."""
    rng = np.random.default_rng(7)
    verdicts = set()
    for _ in range(60):
        count = int(rng.integers(15, 300))
        pixel_i, pixel_j = rng.uniform([0, 0], [319, 239], (2, count, 2))
        fit = fit_homography(Points.alike(pixel_i), Points.alike(pixel_j), WIDE.corners_px)
        verdict = "none" if fit is None else reason(fit, pixel_j)
        assert verdict
        verdicts.add(verdict)
    assert verdicts & {"too few inliers", "outlier share above gamma_1"}


def test_relative_change_measures_the_local_step_in_picture_widths() -> None:
    """gamma_2, equation 2: element by element, unchanged is 1."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        H = true_homography(CAMERA, *pair(rng, 1.0, 1.0, 0.05))
        assert relative_change(np.eye(3), CAMERA) == pytest.approx(1.0)
        # The scale of a homography is nothing.
        assert relative_change(-7 * H, CAMERA) == pytest.approx(relative_change(H, CAMERA))
        shift = np.eye(3)
        shift[:2, 2] = 320, -160
        assert relative_change(shift, CAMERA) == pytest.approx(1 + 1.5 / 9)
        assert relative_change(np.diag([3.0, 0.5, 1]), CAMERA) == pytest.approx(1 + 2.5 / 9)


def test_relative_change_refuses_no_plausible_step_but_wild_ones() -> None:
    rng = np.random.default_rng(9)
    for _ in range(50):
        i, j = pair(rng, 1.0, rng.uniform(0.4, 2.5), 0.1)
        assert relative_change(true_homography(CAMERA, i, j), CAMERA) < GATES.max_relative_change
    wild = np.diag([-9.0, -9, 1])
    assert relative_change(wild, CAMERA) > GATES.max_relative_change
