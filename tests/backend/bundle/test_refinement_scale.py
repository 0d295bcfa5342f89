"""Scale and height of a refinement, and the errors of the sonar that determines them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from backend.bundle.refinement import refine
from tests.backend.bundle.made_scenes import ROUGH, SEEDS, SONAR, errors_squared
from tests.backend.made_floor import make


def test_height_uncertainty_of_a_sonar_includes_the_relief():
    """The sensor may measure the tops or the ground between them, however exact it is stated to be."""
    level, rough = (refine((m := make(scene, 0)).measurements, m.start) for scene in (SONAR, ROUGH))
    assert level.range_errors.zero_std_m < 0.003
    assert rough.range_errors.zero_std_m == pytest.approx(ROUGH.relief * ROUGH.height_m, rel=0.3)
    assert rough.scale_std == pytest.approx(ROUGH.relief, rel=0.3)


@pytest.mark.parametrize("relief", [pytest.param(0.0, marks=pytest.mark.slow), 0.05])
def test_the_flat_floor_does_not_shrink_the_map(relief: float):
    """Points pulled to the floor must not pull the scale: ranges alone make it, without bias.

    Were the map kept in metres, a smaller one would have less relief, and the prior would make it so.
    """
    scene = replace(
        SONAR, relief=relief, range_std_m=0.08, attitude_std_rad=None, points_in_view=60, keyframes=10
    )
    scale = []
    for seed in SEEDS:
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start)
        scale.append(np.log(bundle.w_T_b[:, 2, 3].mean() / made.w_T_b[:, 2, 3].mean()))
    of_ranges = 0.08 / 0.8 / np.sqrt(scene.keyframes)
    assert abs(np.mean(scale)) < 3 * of_ranges / np.sqrt(len(SEEDS))
    assert 0.5 * of_ranges < np.std(scale) < 1.6 * of_ranges


@pytest.mark.slow
def test_a_sonar_that_reads_short_is_inside_the_covariance():
    """Gains of 4 % (one sigma): honest with the prior, far from it without."""
    honest, overconfident = [], []
    for seed in SEEDS:
        gain = 1 + 0.04 * np.random.default_rng(1000 + seed).normal()
        made = make(replace(SONAR, range_gain=gain, range_gain_std=0.04), seed)
        start = made.start
        honest.append(errors_squared(made, refine(made.measurements, start))[6])
        exact = replace(made.measurements, range_gain_std=0.0)
        overconfident.append(errors_squared(made, refine(exact, start))[6])
    lower, upper = chi2.ppf([0.001, 0.999], 6 * len(SEEDS)) / len(SEEDS)
    assert lower < np.mean(honest) < upper
    assert np.mean(overconfident) > 3 * upper


@pytest.mark.slow
def test_two_heights_separate_zero_and_scale_of_a_sonar():
    """Zero 3 cm off at 0.5 and 1.1 m: found, with an honest standard deviation; the map keeps its size."""
    scene = replace(
        SONAR, height_swing=0.4, range_gain_std=0.05, range_datum_m=0.03, range_datum_std_m=0.05, keyframes=20
    )
    off, length = [], []
    for seed in SEEDS:
        made = make(scene, seed)
        bundle = refine(made.measurements, made.start)
        found = bundle.range_errors
        assert found is not None
        assert found.zero_std_m < 0.02
        off.append((found.zero_m - 0.03) / found.zero_std_m)
        length.append(bundle.w_T_b[:, 2, 3].mean() / made.w_T_b[:, 2, 3].mean() - 1.0)
    lower, upper = chi2.ppf([0.001, 0.999], len(SEEDS)) / len(SEEDS)
    assert lower < np.mean(np.square(off)) < upper
    assert np.abs(length).mean() < 0.02


def test_one_height_leaves_the_zero_of_a_sonar_at_its_prior():
    scene = replace(SONAR, height_swing=0.0, range_gain_std=0.05, range_datum_m=0.03, range_datum_std_m=0.05)
    made = make(scene, 0)
    found = refine(made.measurements, made.start).range_errors
    assert found is not None
    assert found.zero_std_m > 0.04
    assert found.gain_std > 0.04


def test_without_a_metric_measurement_the_initial_scale_is_kept():
    made = make(replace(SONAR, range_std_m=None), 0)
    bundle = refine(made.measurements, made.start)
    assert bundle.w_T_b[0, 2, 3] == pytest.approx(made.start[0, 2, 3], rel=1e-8)
    # Shape right, size the start's: 3 % too large.
    assert bundle.w_T_b[-1, 0, 3] / bundle.w_T_b[-1, 2, 3] == pytest.approx(
        made.w_T_b[-1, 0, 3] / made.w_T_b[-1, 2, 3], abs=0.01
    )
    assert np.isfinite(bundle.covariances).all()


def test_the_scale_given_the_gain_of_the_ranges_is_more_certain():
    """The gain that all ranges share has a standard deviation of several per cent."""
    made = make(replace(SONAR, range_gain_std=0.05), 0)
    bundle = refine(made.measurements, made.start)
    assert bundle.scale_std > 0.5 * made.measurements.range_gain_std
    assert 0 < bundle.conditional_scale_std < 0.5 * bundle.scale_std
