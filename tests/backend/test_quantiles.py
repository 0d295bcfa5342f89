"""Quantiles and tails against scipy.stats."""

from __future__ import annotations

import pytest
from scipy.stats import binom, chi2, f

from backend.quantiles import (
    binomial_tail,
    chi_square_limit,
    chi_square_quantile,
    chi_square_tail,
    f_limit,
    f_tail,
)


@pytest.mark.parametrize("dof", [1, 2, 6, 37.5, 4000])
@pytest.mark.parametrize("probability", [1e-12, 1e-4, 0.05, 0.5, 0.99])
def test_chi_square(dof: float, probability: float) -> None:
    assert chi_square_quantile(probability, dof) == pytest.approx(chi2.ppf(probability, dof), rel=1e-9)
    limit = chi_square_limit(probability, dof)
    assert limit == pytest.approx(chi2.isf(probability, dof), rel=1e-9)
    assert chi_square_tail(limit, dof) == pytest.approx(probability, rel=1e-9)


@pytest.mark.parametrize("dof", [1, 2, 6])
@pytest.mark.parametrize("dof_noise", [1, 3.5, 40, 1e5])
@pytest.mark.parametrize("probability", [1e-9, 1e-4, 0.05, 0.5, 0.99])
def test_ratio_of_variances(dof: float, dof_noise: float, probability: float) -> None:
    limit = f_limit(probability, dof, dof_noise)
    assert limit == pytest.approx(f.isf(probability, dof, dof_noise), rel=1e-6)
    assert f_tail(limit, dof, dof_noise) == pytest.approx(probability, rel=1e-6)


@pytest.mark.parametrize("least", [0, 1, 3, 10])
def test_number_of_events(least: int) -> None:
    assert binomial_tail(least, 10, 0.01) == pytest.approx(binom.sf(least - 1, 10, 0.01), rel=1e-9)
