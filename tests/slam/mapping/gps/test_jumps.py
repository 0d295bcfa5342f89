"""Jumps of the fixes against the map, which a wrong scale hides in the residuals."""

import numpy as np
import pytest

from slam.mapping.gps.consensus import exact_agreement
from slam.mapping.gps.jumps import jumps

STD = (5.0, 5.0, 10.0)


def drifting(rng, n, step_m=2.0):
    """Residuals (n, 2) of a receiver whose error wanders."""
    return np.cumsum(rng.normal(0, step_m, (n, 2)), axis=0)


@pytest.mark.parametrize("n", [7, 14, 75])
def test_a_receiver_that_drifts_does_not_jump(n):
    rng = np.random.default_rng(n)
    found = sum(len(jumps(drifting(rng, n), (0.0, 0.0, 0.0))) > 0 for _ in range(1000))
    assert found <= 5  # 1 is expected


@pytest.mark.parametrize("n", [8, 14, 75])
def test_a_jump_is_found_where_the_map_is_stretched_over_it(n):
    """The residuals are a sawtooth, of which no fix stands out."""
    rng = np.random.default_rng(n)
    stretched = 60.0 * (np.arange(n) >= n // 2) - 60.0 * np.linspace(-0.25, 1.25, n)
    for _ in range(20):
        off = drifting(rng, n)
        off[:, 1] += stretched
        assert exact_agreement(np.column_stack([off, off[:, :1]]), STD).used.all()
        assert jumps(off, STD).tolist() == [n // 2]


def test_a_step_within_the_nominal_deviations_is_none():
    off = np.random.default_rng(0).normal(0, 0.1, (20, 2))
    off[10:, 0] += 15.0
    assert not len(jumps(off, STD))
    assert jumps(off, (0.1, 0.1, 0.2)).tolist() == [10]


def test_few_fixes_are_not_judged():
    assert not len(jumps(np.array([[0.0, 0], [0, 0], [99, 0], [99, 0]]), STD))
    assert not len(jumps(np.zeros((0, 2)), STD))
