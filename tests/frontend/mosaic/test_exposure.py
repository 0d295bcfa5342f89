"""Gains and vignetting estimated from synthetic overlaps."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.mosaic.exposure import Exposure, Samples, estimate_exposure


def strip(
    seed: int,
    views: int = 30,
    gain_std: float = 0.15,
    a: tuple[float, float] = (0.0, 0.0),
    noise: float = 0.03,
) -> tuple[Samples, np.ndarray]:
    """Pictures in a row, each point seen by about three of them; the true log gain of each."""
    rng = np.random.default_rng(seed)
    gain = rng.normal(0, gain_std, views)
    gain -= gain.mean()
    points = 60 * views
    where = rng.uniform(-1, views, points)
    floor = rng.normal(4.5, 0.4, points)
    side = rng.uniform(-1, 1, points)
    point, view = np.nonzero(np.abs(where[:, None] - np.arange(views)) < 1.5)
    rho2 = ((where[point] - view) / 1.5) ** 2 / 2 + side[point] ** 2 / 2
    y = floor[point] - gain[view] - a[0] * rho2 - a[1] * rho2**2 + rng.normal(0, noise, len(point))
    return Samples(point, view, rho2, np.repeat(y[:, None], 3, axis=1)), gain


def test_gains_are_estimated_and_seams_decrease() -> None:
    samples, gain = strip(1)
    found = estimate_exposure(samples, 30)
    error = np.log(found.gain[:, 0]) - gain
    assert error.std() < 0.15 * gain.std()
    assert found.seam_before > 0.15
    # What is left is the noise of two readings.
    assert found.seam_after == pytest.approx(0.03 * np.sqrt(2), rel=0.15)


def test_equal_pictures_are_not_changed() -> None:
    samples, _ = strip(2, gain_std=0.0)
    found = estimate_exposure(samples, 30)
    assert np.abs(np.log(found.gain)).max() < 0.02
    assert np.abs(found.vignette).max() < 0.03


def test_vignetting_is_separated_from_gains() -> None:
    samples, gain = strip(3, a=(0.25, 0.15))
    found = estimate_exposure(samples, 30)
    rho2 = np.linspace(0, 1, 20)
    shape = found.vignette[0, 0] * rho2 + found.vignette[1, 0] * rho2**2
    # A constant common to all pictures cannot be seen in overlaps.
    error = shape - (0.25 * rho2 + 0.15 * rho2**2)
    assert np.ptp(error) < 0.04
    assert np.std(np.log(found.gain[:, 0]) - gain) < 0.02


def test_outliers_hardly_move_the_gains() -> None:
    samples, gain = strip(4)
    bad = np.random.default_rng(5).random(len(samples.point)) < 0.1
    y = samples.log_bgr + np.where(bad, 1.5, 0.0)[:, None]
    found = estimate_exposure(Samples(samples.point, samples.view, samples.rho2, y), 30)
    error = np.log(found.gain[:, 0]) - gain
    assert np.std(error) < 0.06


def test_pictures_without_overlap_keep_gain_one() -> None:
    rng = np.random.default_rng(6)
    lonely = Samples(np.arange(50), np.repeat([0, 1], 25), rng.random(50), rng.normal(4, 1, (50, 3)))
    found = estimate_exposure(lonely, 2)
    np.testing.assert_array_equal(found.gain, Exposure.neutral(2).gain)
    samples, _ = strip(7)
    more = estimate_exposure(samples, 31)
    np.testing.assert_allclose(more.gain[30], 1)


def test_channels_are_balanced_one_by_one() -> None:
    samples, _ = strip(8)
    y = samples.log_bgr.copy()
    y[:, 2] += np.where(samples.view % 2 == 0, 0.1, -0.1)
    found = estimate_exposure(Samples(samples.point, samples.view, samples.rho2, y), 30)
    ratio = np.log(found.gain[:, 2] / found.gain[:, 0])
    assert np.std(ratio - np.where(np.arange(30) % 2 == 0, -0.1, 0.1)) < 0.02
