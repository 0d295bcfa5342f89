"""The Cramer-Rao bound: reached by the refinement on made floors, never beaten, and true to its noise."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from backend import se3
from backend.bundle.information import information
from backend.bundle.problem import BundleConfig
from backend.bundle.refinement import refine
from slam.core.errors import InputError
from slam.evaluation.bound import Bound, at_the_truth, cramer_rao
from slam.mapping.pipeline import optimize_with_observations
from tests.backend.made_floor import Made, Scene, aligned, make
from tests.slam.small_flight import flown

SEEDS = range(20)
CONFIG = BundleConfig()


def bound_of(made: Made) -> Bound:
    ideal, measured, noise = at_the_truth(made.measurements, made.w_T_b, CONFIG)
    there = replace(CONFIG, rounds=1, start_relief=noise.relief)
    found = refine(ideal, made.w_T_b, 0.0, there)
    np.testing.assert_allclose(found.w_T_b, made.w_T_b, atol=1e-5)
    assert found.error < 1e-4
    told = information(ideal, made.w_T_b, there)
    return Bound(np.arange(len(made.w_T_b)), made.w_T_b, found.covariances, noise, told, measured)


@lru_cache
def drawn() -> tuple[list[np.ndarray], list[Bound]]:
    """Position errors (n, 3) in world axes and bounds, over the seeds."""
    errors, bounds = [], []
    for seed in SEEDS:
        made = make(Scene(), seed)
        hat = aligned(refine(made.measurements, made.start, 0.0).w_T_b, made.w_T_b)
        errors.append((hat - made.w_T_b)[:, :3, 3])
        bounds.append(bound_of(made))
    return errors, bounds


def test_the_refinement_reaches_the_bound_and_does_not_beat_it():
    errors, bounds = drawn()
    error = np.mean([(e**2).sum(axis=1).mean() for e in errors])
    ratio = error / np.mean([b.position_rmse_m**2 for b in bounds])
    freedom = sum(b.effective_freedom for b in bounds)
    assert chi2.ppf(0.001, freedom) / freedom < ratio < chi2.ppf(0.999, freedom) / freedom


def test_in_every_direction():
    """Errors whitened by the joint bound of all positions have unit variance: 45 numbers a flight."""
    errors, bounds = drawn()
    squared = [
        e[1:].ravel() @ np.linalg.solve(b.position_covariance_m2[3:, 3:], e[1:].ravel())
        for e, b in zip(errors, bounds, strict=True)
    ]
    freedom = len(squared) * len(errors[0][1:]) * 3
    # The noise levels are estimated from few residuals on both sides: a little more than the bound.
    assert chi2.ppf(0.001, freedom) / freedom < np.sum(squared) / freedom < 1.3


def test_the_joint_bound_has_the_covariances_of_single_keyframes():
    """Two ways: gtsam's elimination in the gauge of the first one, and the information of all together."""
    _, bounds = drawn()
    for bound in bounds[:3]:
        R = bound.w_T_b[:, :3, :3]
        single = R @ bound.covariances[:, 3:, 3:] @ np.swapaxes(R, 1, 2)
        n = len(R)
        joint = bound.position_covariance_m2.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
        np.testing.assert_allclose(joint, single, atol=2e-3 * single.max())


def test_the_noise_at_the_truth_is_what_was_put_in():
    _, bounds = drawn()
    levels = [(b.noise.pixel_scale, b.noise.roll_pitch_rad, b.noise.range_m) for b in bounds]
    # What lasts along a track counts as noise, so that of pixels comes out a little larger.
    assert (np.abs(np.mean(levels, axis=0) / [1.0, 0.01, 0.01] - 1) < [0.08, 0.05, 0.08]).all()


def test_twice_the_noise_doubles_the_bound():
    _, bounds = drawn()
    twice = Scene(pixel_std=0.6, attitude_std_rad=0.02, range_std_m=0.02)
    one, two = (
        np.mean([b.position_rmse_m**2 for b in some])
        for some in (bounds, [bound_of(make(twice, seed)) for seed in SEEDS])
    )
    assert np.sqrt(two / one) == pytest.approx(2.0, rel=0.15)


def test_a_barometer_does_not_change_the_bound():
    with_it = bound_of(make(Scene(barometer_std_m=0.3), 0))
    assert with_it.position_rmse_m == pytest.approx(bound_of(make(Scene(), 0)).position_rmse_m, rel=0.1)


def test_a_landmarks_place_moves_as_its_gradient_says():
    flight, made = flown(), make(Scene(), 0)
    assert flight.camera is not None
    # The gradient of the mean place by one body's pose, against differences of where its ray meets z = 0.
    flight = replace(flight, landmarks={"A": np.array([0.3, 0.1, 0.0])})
    gradient = bound_of(made)._place_gradient(flight, "A")
    seen = np.flatnonzero(np.abs(gradient).max(axis=(1, 2)))
    assert len(seen) > 2
    pose, k = made.w_T_b[seen[0]], seen[0]
    b_ray = np.linalg.inv(pose @ flight.camera.b_T_c) @ [0.3, 0.1, 0.0, 1.0]

    def place(xi: np.ndarray) -> np.ndarray:
        w_T_c = pose @ se3.exp(xi[None])[0] @ flight.camera.b_T_c
        ray = w_T_c[:3, :3] @ b_ray[:3]
        return w_T_c[:3, 3] - w_T_c[2, 3] / ray[2] * ray

    steps = 1e-6 * np.eye(6)
    numeric = np.column_stack([(place(s) - place(-s)) / 2e-6 for s in steps]) / len(seen)
    np.testing.assert_allclose(gradient[k], numeric, atol=1e-6)


@pytest.mark.slow
def test_of_a_flight():
    flight = flown()
    estimate, observations = optimize_with_observations(flight)
    bound = cramer_rao(flight, estimate, observations)
    own = np.sqrt(np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2).mean())
    assert bound.position_rmse_m == pytest.approx(own, rel=0.4)
    assert (np.diff(bound.keyframes) > 0).all()
    n = len(bound.w_T_b)
    assert np.trace(bound.position_covariance_m2) / n == pytest.approx(bound.position_rmse_m**2, rel=0.02)
    assert 1 < bound.effective_freedom < 6
    assert 0.3 < bound.distance_std_m(flight, "A", "B") / bound.position_rmse_m < 3
    with pytest.raises(InputError, match="needs its truth"):
        cramer_rao(replace(flight, truth=None), estimate, observations)
