"""Errors of predictions that start anew: where they start, and that they begin with nothing."""

from __future__ import annotations

import numpy as np

from slam.data_quality.inertial_comparison import IntegralComparison
from slam.report.criticism.prediction_errors import SHOWN_S, PredictionErrors, integral_errors
from slam.report.criticism.segment import RESTART_S


def test_a_second_integral_begins_with_no_error_however_far_it_has_drifted():
    random, excess_m_s2 = np.random.default_rng(3), 0.1
    stamps_s = np.sort(random.uniform(0.0, 800.0, 40_000))  # readings that are not evenly spaced
    drift_m = excess_m_s2 / 2 * stamps_s[:, None] ** 2
    seen = IntegralComparison(stamps_s, drift_m, np.zeros_like(drift_m), 2, np.zeros_like(stamps_s))
    found = integral_errors(seen, 0, np.zeros(0))
    since_s = stamps_s % RESTART_S
    known = np.isfinite(found.off)
    assert known.mean() > 0.95
    # Beside the line through start and middle, a constant excess leaves a parabola with both as roots.
    expected_m = excess_m_s2 / 2 * since_s * (since_s - RESTART_S / 2)
    assert np.abs(found.off - expected_m)[known].max() < 0.002


def test_the_worst_stretch_begins_with_a_prediction():
    stamps_s, restart_s = np.arange(0.3, 100.0, 0.02), 0.7
    off = np.where((stamps_s > 40.0) & (stamps_s < 70.0), 1.0, 0.1)
    begin_s = PredictionErrors(stamps_s, off, restart_s).worst()[1]
    assert abs((begin_s - restart_s) / RESTART_S - round((begin_s - restart_s) / RESTART_S)) < 1e-9
    assert 40.0 - RESTART_S <= begin_s <= 70.0 - SHOWN_S + RESTART_S
