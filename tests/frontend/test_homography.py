"""The robust fit: recovers the truth, knows its own uncertainty, and says no where there is no plane."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.homography import HomographyConfig, HomographyFit, fit_homography, transfer
from frontend.points import Points
from tests.frontend.floor_pairs import CAMERA, Array, pair, true_homography

CORNERS = CAMERA.corners_px
SIZE = np.array(CAMERA.size_px) - 1.0


def matches(
    rng: np.random.Generator, count: int, noise_px: float, outliers: float, ratio: float = 1.0
) -> tuple[Array, Array, Array, np.ndarray]:
    """True i_H_j, matched pixels of i and j with noise in both pictures, and which of them are wrong."""
    H = true_homography(CAMERA, *pair(rng, 1.0, ratio, 0.05))
    pixel_j = rng.uniform([0, 0], SIZE, (12 * count, 2))
    pixel_i = transfer(H, pixel_j)
    seen = ((pixel_i > 0) & (pixel_i < SIZE)).all(axis=1)
    pixel_i, pixel_j = pixel_i[seen][:count], pixel_j[seen][:count]
    wrong = rng.random(len(pixel_i)) < outliers
    pixel_i, pixel_j = (p + rng.normal(0, noise_px, p.shape) for p in (pixel_i, pixel_j))
    pixel_i[wrong] = rng.uniform([0, 0], SIZE, (wrong.sum(), 2))
    return H, pixel_i, pixel_j, wrong


def fit_of(pixel_i: Array, pixel_j: Array, corners_px: Array = CORNERS) -> HomographyFit | None:
    """Of matched pixels, each as surely known as the other."""
    return fit_homography(Points.alike(pixel_i), Points.alike(pixel_j), corners_px)


def corner_nees(fit: HomographyFit, H: Array) -> float:
    error = (transfer(fit.i_H_j, CORNERS) - transfer(H, CORNERS)).ravel()
    return float(error @ np.linalg.solve(fit.corner_covariance, error))


@pytest.mark.parametrize(
    ("count", "noise_px", "outliers", "ratio"),
    [
        (30, 0.3, 0.0, 1.0),
        (150, 0.2, 0.0, 1.0),
        pytest.param(150, 0.5, 0.3, 1.0, marks=pytest.mark.slow),
        (150, 0.5, 0.6, 1.0),
        pytest.param(150, 0.4, 0.1, 2.0, marks=pytest.mark.slow),
        (150, 0.4, 0.1, 0.5),
    ],
)
def test_corner_covariance_predicts_the_errors(
    count: int, noise_px: float, outliers: float, ratio: float
) -> None:
    """The mean of chi² with 8 degrees of freedom, +- 4 standard errors and 4 % for the model."""
    trials = 160
    rng = np.random.default_rng([count, int(10 * outliers), int(10 * ratio)])
    nees, noise, right, wrong_in = [], [], [], []
    for _ in range(trials):
        H, pixel_i, pixel_j, wrong = matches(rng, count, noise_px, outliers, ratio)
        fit = fit_of(pixel_i, pixel_j)
        assert fit is not None
        nees.append(corner_nees(fit, H))
        noise.append(fit.noise_px)
        right.append(fit.inlier[~wrong].mean())
        wrong_in.append(fit.inlier[wrong].sum())
    slack = 4 * 4 / np.sqrt(trials) + 0.3
    assert 8 - slack < np.mean(nees) < 8 + slack
    assert 0.90 < np.mean(noise) / noise_px < 1.05
    assert np.mean(right) > 0.98
    assert np.mean(wrong_in) < 0.01 * count


def test_points_that_are_known_less_well_count_less() -> None:
    """Half of the points err three times as much: told so, the fit is better, and knows how good it is."""
    rng, trials = np.random.default_rng(9), 160
    told, untold, nees = [], [], []
    for _ in range(trials):
        H, pixel_i, pixel_j, _ = matches(rng, 120, 0.0, 0.0)
        coarse = np.arange(len(pixel_i)) % 2 == 0
        spread_i = spread_j = np.where(coarse, 3.0, 1.0)
        pixel_i, pixel_j = (
            p + 0.15 * s[:, None] * rng.normal(size=p.shape)
            for p, s in ((pixel_i, spread_i), (pixel_j, spread_j))
        )
        fit = fit_homography(Points(pixel_i, spread_i), Points(pixel_j, spread_j), CORNERS)
        even = fit_of(pixel_i, pixel_j)
        assert fit is not None
        assert even is not None
        nees.append(corner_nees(fit, H))
        for off, found in ((told, fit), (untold, even)):
            off.append(np.mean((transfer(found.i_H_j, CORNERS) - transfer(H, CORNERS)) ** 2))
    assert np.median(told) < 0.8 * np.median(untold)
    slack = 4 * 4 / np.sqrt(trials) + 0.3
    assert 8 - slack < np.mean(nees) < 8 + slack


def test_without_noise_the_truth_comes_back_and_the_floor_of_the_noise_holds() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        H, pixel_i, pixel_j, _ = matches(rng, 60, 0.0, 0.2)
        fit = fit_of(pixel_i, pixel_j)
        assert fit is not None
        np.testing.assert_allclose(transfer(fit.i_H_j, CORNERS), transfer(H, CORNERS), atol=1e-3)
        assert fit.noise_px == HomographyConfig().noise_floor_px
        assert fit.i_H_j[2, 2] == 1


def test_covariance_is_that_of_the_corners_asked_for_and_shrinks_with_the_number_of_matches() -> None:
    rng = np.random.default_rng(4)
    _, pixel_i, pixel_j, _ = matches(rng, 400, 0.3, 0.0)
    few = fit_of(pixel_i[:100], pixel_j[:100])
    many = fit_of(pixel_i, pixel_j)
    rolled = fit_of(pixel_i, pixel_j, np.roll(CORNERS, 1, axis=0))
    assert few is not None
    assert many is not None
    assert rolled is not None
    assert 2.5 < np.trace(few.corner_covariance) / np.trace(many.corner_covariance) < 6.5
    np.testing.assert_allclose(
        np.roll(many.corner_covariance, (2, 2), (0, 1)), rolled.corner_covariance, rtol=1e-6, atol=1e-12
    )
    np.testing.assert_array_equal(many.corner_covariance, many.corner_covariance.T)
    assert np.linalg.eigvalsh(many.corner_covariance)[0] > 0


def test_fit_does_not_depend_on_the_order_of_the_pictures() -> None:
    rng = np.random.default_rng(5)
    for _ in range(10):
        _, pixel_i, pixel_j, _ = matches(rng, 150, 0.3, 0.2, 1.5)
        there, back = (
            fit_of(pixel_i, pixel_j),
            fit_of(pixel_j, pixel_i),
        )
        assert there is not None
        assert back is not None
        std = np.sqrt(np.diag(there.corner_covariance).max())
        shift = transfer(np.linalg.inv(back.i_H_j), CORNERS) - transfer(there.i_H_j, CORNERS)
        assert np.abs(shift).max() < 0.7 * std
        again = fit_of(pixel_i, pixel_j)
        assert again is not None
        np.testing.assert_array_equal(again.i_H_j, there.i_H_j)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_four_matches_give_none(count: int) -> None:
    p = np.array([[0.0, 0], [100, 0], [0, 100]])[:count].reshape(-1, 2)
    assert fit_of(p, p) is None


def test_collinear_and_identical_points_give_none_or_no_certainty() -> None:
    """A line leaves the corners free: what comes back must say so."""
    rng = np.random.default_rng(6)
    t = rng.uniform(0, 1, (60, 1))
    line = np.array([[20.0, 30]]) + t * [250, 150]
    for noise in (0.0, 0.3):
        fit = fit_of(line + rng.normal(0, noise, line.shape), line)
        assert fit is None or not np.sqrt(np.diag(fit.corner_covariance).max()) < 0.03 * 320
    same = np.tile([[50.0, 60]], (30, 1))
    fit = fit_of(same, same)
    assert fit is None or not np.sqrt(np.diag(fit.corner_covariance).max()) < 0.03 * 320


def test_wide_pictures_get_a_wider_threshold() -> None:
    config = HomographyConfig()
    assert [config.for_width(w).threshold_px for w in (320, 500, 4000)] == [3.0, 3.0, 24.0]


def test_transfer_is_the_projective_map() -> None:
    H = np.array([[1.0, 0.2, 3], [0.1, 0.9, -4], [1e-3, -2e-3, 1]])
    u = H @ [50, 60, 1]
    np.testing.assert_allclose(transfer(H, np.array([[50.0, 60]])), [u[:2] / u[2]])
