"""Whitening of errors whose coordinates have units far apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ortho_group

from backend.whitening import whitening


def made(rng: np.random.Generator, size: int) -> np.ndarray:
    """A covariance in units that are up to 1e6 apart, of errors that are moderately correlated."""
    axes = ortho_group.rvs(size, random_state=rng)
    units = np.diag(10.0 ** rng.uniform(-6, 6, size))
    return np.asarray(units @ axes @ np.diag(rng.uniform(0.5, 2.0, size)) @ axes.T @ units)


@pytest.mark.parametrize("size", [1, 3, 8, 15])
def test_whitened_errors_have_unit_covariance(size):
    rng = np.random.default_rng(size)
    stack = np.array([made(rng, size) if size > 1 else np.array([[rng.uniform()]]) for _ in range(20)])
    for W, C in zip(whitening(stack), stack, strict=True):
        np.testing.assert_allclose(W @ C @ W.T, np.eye(size), atol=1e-12)
    np.testing.assert_array_equal(whitening(stack[0]), whitening(stack)[0])
    assert whitening(stack[:0]).shape == (0, size, size)


def test_a_covariance_that_is_none_raises():
    with pytest.raises(np.linalg.LinAlgError):
        whitening(np.diag([1.0, -1.0]))
