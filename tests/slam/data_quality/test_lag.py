"""Readings that lag: by a delay, by a filter, and by none."""

from __future__ import annotations

import numpy as np
import pytest

from slam.data_quality.lag import PROMPT, Lag

STAMPS_S = np.sort(np.random.default_rng(0).uniform(0, 4, 400))
RAMP = np.column_stack([STAMPS_S, 1.0 - 2.0 * STAMPS_S])
SETTLED = STAMPS_S > 1.5


@pytest.mark.parametrize("lag", [Lag(0.1), Lag(-0.1), Lag(0.0, 0.1), Lag(-0.05, 0.15)])
def test_a_ramp_is_late_by_the_delay_and_the_time_constant(lag):
    late_s = lag.delay_s + lag.smoothing_s
    expected = np.column_stack([STAMPS_S - late_s, 1.0 - 2.0 * (STAMPS_S - late_s)])
    inside = SETTLED & (STAMPS_S < 3.8)
    np.testing.assert_allclose(lag.of(STAMPS_S, RAMP)[inside], expected[inside], atol=1e-3)


def test_a_filter_weakens_a_motion_as_one_of_the_first_order():
    w = 2 * np.pi * 1.5
    found = Lag(smoothing_s=0.1).of(STAMPS_S, np.sin(w * STAMPS_S)[:, None])[:, 0]
    gain = 1.0 / (1.0 + 0.1j * w)
    np.testing.assert_allclose(found[SETTLED], (gain * np.exp(1j * w * STAMPS_S)).imag[SETTLED], atol=0.03)


def test_prompt_readings_are_those_of_the_motion():
    assert PROMPT.of(STAMPS_S, RAMP) is RAMP
