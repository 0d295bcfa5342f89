"""The median is numpy's; the deviation is that of most values, whatever the rest are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frontend.robust import median, robust_std


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_the_median_is_numpys(values):
    assert median(np.array(values)) == pytest.approx(np.median(values))


def test_a_tenth_far_off_hardly_moves_the_deviation():
    values = np.random.default_rng(5).normal(0.0, 2.0, 20_000)
    assert robust_std(values) == pytest.approx(2.0, rel=0.03)
    values[::10] = 1e6
    assert robust_std(values) == pytest.approx(2.0, rel=0.2)
    assert np.isnan(robust_std(np.append(values, np.nan)))
