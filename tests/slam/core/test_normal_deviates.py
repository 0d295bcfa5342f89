"""Deviates of sizes whose variances are estimated from few segments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from slam.core.normal_deviates import deviate, robust_deviate, robust_sigmas


@pytest.mark.parametrize("free", [1.0, 7.0, 40.0])
def test_the_deviate_of_one_size_has_the_tail_of_students_t(free):
    for sigmas in (0.5, 2.0, 8.0):
        assert 2.0 * norm.sf(robust_deviate(sigmas**2, 1, free)) == pytest.approx(
            2.0 * student.sf(sigmas, free)
        )


@pytest.mark.parametrize("degrees", [1, 3])
@pytest.mark.parametrize("free", [2.0, 12.0, 1e4, np.inf])
def test_the_sigmas_of_a_deviate_have_this_deviate(degrees, free):
    for z in (1.0, 4.0):
        sigmas = robust_sigmas(z, degrees, free)
        assert robust_deviate(sigmas**2, degrees, free) == pytest.approx(z, rel=1e-4)


def test_known_variances_give_the_deviate_of_chi_square():
    assert robust_deviate(30.0, 3, np.inf) == deviate(30.0, 3)
    assert robust_deviate(30.0, 3, 1e6) == pytest.approx(deviate(30.0, 3), rel=1e-3)


@pytest.mark.parametrize("degrees", [1, 3])
def test_far_out_the_deviate_grows_without_a_step(degrees):
    squares = np.geomspace(1e2, 1e6, 200)
    z = np.array([robust_deviate(square, degrees, 400.0) for square in squares])
    assert np.all(np.diff(z) > 0.0)
    assert np.max(np.diff(z)) < 1.5
