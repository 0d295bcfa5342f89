"""The typical noise of edges over the stated one, on flights whose neighbours check each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend import se3
from backend.measurements import Measurements, RelativePose
from backend.pose_graph.edge_noise import typical_variance
from backend.pose_graph.solve import solve
from backend.quantiles import chi_square_quantile
from tests.backend.synthetic import Made, falsified, flight

BESIDE_STD = np.array([0.006, 0.006, 0.01, 0.015, 0.015, 0.015])


def seen_by_neighbours(seed: int, noise: float, reach: int = 3) -> Made:
    """Return a flight whose keyframes see up to ``reach`` later ones, with ``noise`` times the stated one."""
    made, rng = flight(seed, n=60, loops=24), np.random.default_rng(seed)
    pairs = [(k, k + step) for step in range(1, reach + 1) for k in range(60 - step)]
    pairs += [(e.i, e.j) for e in made.measurements.relative_poses if e.kind == "loop"]
    T = made.truth
    edges = tuple(
        RelativePose(
            i,
            j,
            se3.inverse(T[i]) @ T[j] @ se3.exp((noise * BESIDE_STD * rng.normal(size=6))[None])[0],
            np.diag(BESIDE_STD**2),
            "odometry" if j - i <= reach else "loop",
        )
        for i, j in pairs
    )
    return Made(replace(made.measurements, relative_poses=edges), T)


def typical(measurements: Measurements) -> float:
    return typical_variance(measurements, solve(measurements, loops_robust=False, covariances=False))


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_noise_of_edges_that_check_each_other(noise: float):
    found = [typical(seen_by_neighbours(seed, noise).measurements) for seed in range(3)]
    assert np.mean(found) == pytest.approx(noise**2, rel=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_false_loops_are_not_the_noise_of_true_edges(seed: int):
    """They strain the fit of all edges everywhere: each is more than a hundred deviations off."""
    made, _ = falsified(seen_by_neighbours(seed, 1.5), 3, seed)
    assert typical(made.measurements) == pytest.approx(1.5**2, rel=0.3)


def test_tails_of_the_noise_take_no_weight_from_it():
    """One edge in eight has thrice the noise of the others. All are true, and pass the test as they are."""
    made, rng = seen_by_neighbours(0, 1.3), np.random.default_rng(0)
    edges = tuple(
        replace(e, i_T_j=e.i_T_j @ se3.exp((2.8 * 1.3 * BESIDE_STD * rng.normal(size=6))[None])[0])
        if k % 8 == 0
        else e
        for k, e in enumerate(made.measurements.relative_poses)
    )
    heavy = replace(made.measurements, relative_poses=edges)
    factor = typical(heavy)
    wider = tuple(replace(e, covariance=factor * e.covariance) for e in edges)
    assert solve(replace(heavy, relative_poses=wider), covariances=False).edge_kept.all()


def test_a_long_cycle_tells_no_noise():
    """Its loop may be false: each edge then counts with its residual, not with the error of the cycle."""
    measurements = flight(0, n=30, loops=1, attitude_std=None, range_std=None).measurements
    false, _ = falsified(Made(measurements, np.zeros(0)), 1, seed=1)
    fit = solve(false.measurements, loops_robust=False, covariances=False)
    of_residuals = float(np.median(fit.edge_residual**2)) / chi_square_quantile(0.5, 6)
    assert typical_variance(false.measurements, fit) <= of_residuals
