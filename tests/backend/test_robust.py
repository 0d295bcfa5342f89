"""Huber's loss: one rule for errors of any size, and covariances that are right with it."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.graph import pose_side_factors, start_variables
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem
from backend.pose_graph.unary_factors import position, slant_range
from backend.robust import huber_limit, robust_unit
from tests.backend.bundle.made_scenes import SCENES
from tests.backend.made_floor import make


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_the_weights_give_the_covariance_of_a_mean(size):
    """Of Gaussian errors, an eighth or so is weighted down, and the mean varies as its weights state."""
    white = np.random.default_rng(size).normal(size=(400_000, size))
    norm = np.linalg.norm(white, axis=1)
    kernel = robust_unit(size).robust()
    limit = huber_limit(size)
    weight = np.minimum(limit / norm, 1.0)
    assert [kernel.weight(x) for x in norm[:50]] == pytest.approx(weight[:50].tolist())
    assert np.mean(weight == 1.0) == pytest.approx(1 - np.exp(-2), abs=2e-3)
    # An M-estimate varies as E[psi^2] / E[psi']^2; its weights state 1 / E[weight].
    steepness = np.mean(np.where(norm < limit, 1.0, weight * (size - 1) / size))
    true = np.mean((weight * norm) ** 2) / size / steepness**2
    assert 1 / np.mean(weight) == pytest.approx(true, rel=0.015)
    assert true < 1.04


@pytest.mark.parametrize("name", ["gps and attitude", "sonar"])
def test_each_factor_keeps_its_weight_up_to_the_limit_of_its_size(name):
    made = make(SCENES[name], 0)
    measured = made.measurements
    problem = BundleProblem(measured, measured.tracks, measured.camera, BundleConfig(), False)
    start = start_variables(problem, made.start, made.floor_z_m).values
    factors = pose_side_factors(problem, start_noise(measured, problem.config), start)
    sizes = {"attitude": 2, "range": 1, "position": 3}
    found = [(factor, size) for kind, size in sizes.items() for factor in factors.of_kind(kind)]
    assert len(found) >= len(start.keys()) - 1
    for factor, size in found:
        kernel = factor.noiseModel().robust()
        assert kernel.weight(0.999 * huber_limit(size)) == 1.0 > kernel.weight(1.001 * huber_limit(size))


def test_an_axis_that_was_not_measured_does_not_count():
    made = make(SCENES["gps"], 0)
    (first, *_) = made.measurements.positions
    flat = type(first)(0, first.w_p_antenna_m, np.array([1.0, 1.0, np.inf]))
    reading = make(SCENES["sonar"], 0).measurements.ranges[0]
    values = gtsam.Values()
    values.insert(POSE(0), gtsam.Pose3())
    for unary, size in ((position(flat), 2), (slant_range(reading), 1)):
        assert unary is not None
        kernel = unary.factor.noiseModel().robust()
        assert kernel.weight(0.999 * huber_limit(size)) == 1.0 > kernel.weight(1.001 * huber_limit(size))
