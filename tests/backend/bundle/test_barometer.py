"""Heights of a barometer in the refinement: the factor, the scale that they tell, and its uncertainty."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.stats import chi2

from backend.bundle.accuracy.information_shares import information_shares
from backend.bundle.barometer import GAIN_STD, HEIGHTS, height_factor
from backend.bundle.refinement import refine
from tests.backend.bundle.test_factors import POSE, SEEDS, draw, metric_world_pose, values_of
from tests.backend.made_floor import Made, Scene, make

CLIMBING = Scene(height_m=10.0, height_swing=0.3, range_std_m=None, barometer_std_m=0.3)


@given(SEEDS)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_the_error_is_that_of_the_height_of_the_body(seed):
    f_T_c, world, c_T_b = draw(seed)
    values = values_of(f_T_c, world)
    values.insert(HEIGHTS, np.array([1.05, 30.0]))
    factor = height_factor(POSE, 7.0, gtsam.noiseModel.Unit.Create(1), np.linalg.inv(c_T_b))
    z = metric_world_pose(f_T_c, world, c_T_b)[2, 3]
    assert factor.unwhitenedError(values) == pytest.approx([1.05 * z + 30.0 - 7.0])
    linear = factor.linearize(values).jacobian()[0]
    columns = [
        (error_at(factor, values, key, step) - error_at(factor, values, key, -step)) / 2e-6
        for key, size in zip(factor.keys(), (6, len(world), 2), strict=True)
        for step in 1e-6 * np.eye(size)
    ]
    assert linear[0] == pytest.approx(np.array(columns), rel=1e-5, abs=1e-5 * np.abs(columns).max())


def error_at(factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, step: np.ndarray) -> float:
    moved = gtsam.Values(values)
    if key == POSE:
        moved.update(key, values.atPose3(key).retract(step))
    else:
        moved.update(key, values.atVector(key) + step)
    return float(factor.unwhitenedError(moved)[0])


def three_times_too_large(made: Made) -> np.ndarray:
    start = made.start.copy()
    start[:, :3, 3] *= 3.0
    return start


def scale_errors(scene: Scene, seeds: range) -> np.ndarray:
    """(n, 2) errors of the logarithm of the scale and their told standard deviations, gains drawn anew."""
    found = []
    for seed in seeds:
        gain = 1 + GAIN_STD * np.random.default_rng(100 + seed).normal()
        made = make(replace(scene, barometer_gain=gain), seed)
        bundle = refine(made.measurements, three_times_too_large(made))
        length = np.linalg.norm(np.diff(bundle.w_T_b[:, :3, 3], axis=0), axis=1).sum()
        true = np.linalg.norm(np.diff(made.w_T_b[:, :3, 3], axis=0), axis=1).sum()
        assert bundle.scale_std is not None
        found.append((np.log(length / true), bundle.scale_std))
    return np.array(found)


def test_changes_of_height_tell_the_scale():
    """Amplitude 3 m, noise 0.3 m, 16 keyframes: 3.5 % beside the 4 % of the gain, from a start at 300 %."""
    error, told = scale_errors(CLIMBING, range(6)).T
    assert told == pytest.approx(np.hypot(0.3 / 3.0 / np.sqrt(8), GAIN_STD), rel=0.3)
    assert np.abs(error).max() < 4 * told.max()


@pytest.mark.slow
def test_the_scale_of_a_barometer_is_within_its_uncertainty():
    error, told = scale_errors(CLIMBING, range(40)).T
    lower, upper = chi2.ppf([0.001, 0.999], len(error)) / len(error)
    assert lower < np.mean((error / told) ** 2) < upper


def test_a_level_flight_leaves_the_scale_open():
    made = make(replace(CLIMBING, height_swing=0.0), 0)
    assert refine(made.measurements, made.start).scale_std > 0.3


def test_a_barometer_beside_a_gps_moves_nothing():
    scene = replace(CLIMBING, position_std_m=(0.02, 0.03))
    made = make(scene, 0)
    alone = refine(replace(made.measurements, heights=()), made.start, made.floor_z_m)
    both = refine(made.measurements, made.start, made.floor_z_m)
    assert np.abs(both.w_T_b - alone.w_T_b).max() < 0.02
    assert both.noise.height_m == pytest.approx(0.3, rel=0.5)


def test_the_barometer_has_its_share_of_the_scale():
    made = make(CLIMBING, 0)
    found = information_shares(refine(made.measurements, made.start).optimum)
    assert found["scale"]["barometer"] > 0.9
