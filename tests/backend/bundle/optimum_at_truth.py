"""Solved problems at their true poses, and the memory of what is computed from them."""

from __future__ import annotations

import tracemalloc

import numpy as np

from backend.bundle.graph import start_variables
from backend.bundle.minimise import BundleCost, BundleOptimum
from backend.bundle.noise import start_noise
from backend.bundle.problem import BundleConfig, BundleProblem
from tests.backend.made_floor import Scene, make


def at_the_truth(keyframes: int) -> BundleOptimum:
    """Problem of a made floor at its true poses, as if these were its optimum."""
    made = make(Scene(points_in_view=10, keyframes=keyframes), seed=0)
    measurements = made.measurements
    config = BundleConfig()
    problem = BundleProblem(
        measurements, measurements.tracks, measurements.camera, config, self_calibrates=False
    )
    at, noise = start_variables(problem, made.w_T_b, 0.0), start_noise(measurements, config)
    used = np.ones(len(measurements.tracks.track), dtype=bool)
    cost = BundleCost.of(problem, noise, used, at.values)
    return BundleOptimum(cost, at, cost.structure(at))


def peak_bytes(work) -> int:
    """Peak memory of a function without arguments."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak
