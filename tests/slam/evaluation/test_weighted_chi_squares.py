"""Quantiles of a weighted sum of chi-squares, against those of scipy and of draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, gamma

from slam.evaluation.weighted_chi_squares import weighted_chi_square_interval


@pytest.mark.parametrize("share", [0.5, 0.95, 0.99])
@pytest.mark.parametrize("dof", [3.0, 7.5, 900.0])
def test_equal_weights_give_one_chi_square(share, dof):
    found = weighted_chi_square_interval(share, np.array([0.2, 0.2]), np.array([0.4 * dof, 0.6 * dof]))
    expected = 0.2 * chi2.ppf([0.5 - share / 2, 0.5 + share / 2], dof)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_second_small_one_is_a_convolution():
    """Of an exponential and a gamma variable, by numerical convolution."""
    x = np.linspace(0, 60, 600_001)
    density = gamma.pdf(x, 3.0, scale=0.6)
    step = x[1] - x[0]
    decayed = np.exp(-x / 2.0)
    cdf = np.cumsum(density) * step - decayed * np.cumsum(density / decayed) * step
    found = weighted_chi_square_interval(0.95, np.array([1.0, 0.3]), np.array([2.0, 6.0]))
    np.testing.assert_allclose(found, np.interp([0.025, 0.975], cdf, x), rtol=1e-3)


def test_uneven_weights_agree_with_draws():
    weights, dof = np.array([0.95, 0.62, 0.51, 0.1]), np.array([1.0, 1.0, 1.0, 39.2])
    draws = np.random.default_rng(2).chisquare(dof, size=(200_000, 4)) @ weights
    lower, upper = weighted_chi_square_interval(0.95, weights, dof)
    assert np.mean(draws < lower) == pytest.approx(0.025, abs=0.0015)
    assert np.mean(draws > upper) == pytest.approx(0.025, abs=0.0015)
