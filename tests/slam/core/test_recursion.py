"""Recursions of the first order against scipy's filter."""

import numpy as np
import pytest
from scipy.signal import lfilter

from slam.core.recursion import recursion


@pytest.mark.parametrize("shape", [(0,), (1,), (500,), (500, 3)])
@pytest.mark.parametrize("keep", [0.0, 0.3, np.float64(0.98)])
def test_a_recursion_equals_the_filter_of_scipy_to_the_bit(shape, keep):
    inputs = np.random.default_rng(0).standard_normal(shape)
    expected = lfilter([1.0], [1.0, -keep], inputs, axis=0)
    assert np.array_equal(recursion(inputs, keep), expected)
