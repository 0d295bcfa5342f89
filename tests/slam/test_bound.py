"""The Cramer-Rao bound: reached by the refinement on made floors, never beaten, and true to its noise."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from backend.bundle.graph import BundleConfig
from backend.bundle.refinement import refine
from slam.bound import at_the_truth, cramer_rao
from slam.errors import InputError
from slam.pipeline import optimize_with_sightings
from tests.backend.made_floor import Made, Scene, aligned, make
from tests.slam.small_flight import flown

SEEDS = range(20)
CONFIG = BundleConfig()


def bound_m(made: Made) -> tuple[float, np.ndarray]:
    ideal, noise = at_the_truth(made.measurements, made.w_T_b, CONFIG)
    found = refine(ideal, made.w_T_b, 0.0, replace(CONFIG, rounds=1, start_relief=noise.relief))
    np.testing.assert_allclose(found.w_T_b, made.w_T_b, atol=1e-5)
    assert found.error < 1e-4
    levels = np.array([noise.pixel_scale, noise.roll_pitch_rad, noise.range_m])
    return float(np.trace(found.covariances[:, 3:, 3:], axis1=1, axis2=2).mean()), levels


@lru_cache
def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squared errors and bounds (m^2), and noise levels at the truth, over the seeds."""
    errors, bounds, levels = [], [], []
    for seed in SEEDS:
        made = make(Scene(), seed)
        hat = aligned(refine(made.measurements, made.start, 0.0).w_T_b, made.w_T_b)
        errors.append(((hat - made.w_T_b)[:, :3, 3] ** 2).sum(axis=1).mean())
        bound, level = bound_m(made)
        bounds.append(bound)
        levels.append(level)
    return np.array(errors), np.array(bounds), np.array(levels)


def test_the_refinement_reaches_the_bound_and_does_not_beat_it():
    errors, bounds, _ = drawn()
    # Few independent errors a flight: over twenty of them the ratio scatters by about a tenth.
    assert 0.75 < np.sqrt(errors.mean() / bounds.mean()) < 1.3


def test_the_noise_at_the_truth_is_what_was_put_in():
    _, _, levels = drawn()
    # What lasts along a track counts as noise, so that of pixels comes out a little larger.
    assert (np.abs(levels.mean(axis=0) / [1.0, 0.01, 0.01] - 1) < [0.15, 0.05, 0.08]).all()


def test_twice_the_noise_doubles_the_bound():
    _, one, _ = drawn()
    twice = Scene(pixel_std=0.6, attitude_std_rad=0.02, range_std_m=0.02)
    two = np.array([bound_m(make(twice, seed))[0] for seed in SEEDS])
    assert np.sqrt(two.mean() / one.mean()) == pytest.approx(2.0, rel=0.15)


def test_of_a_flight():
    flight = flown()
    estimate, sightings = optimize_with_sightings(flight)
    bound = cramer_rao(flight, estimate, sightings)
    own = np.sqrt(np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2).mean())
    assert bound.position_rmse_m == pytest.approx(own, rel=0.4)
    assert (np.diff(bound.keyframes) > 0).all()
    with pytest.raises(InputError, match="needs its truth"):
        cramer_rao(replace(flight, truth=None), estimate, sightings)
