"""The figure eight against its Cramer-Rao bound: position errors over what the measurements allow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.bound import cramer_rao
from slam.evaluation import evaluate
from slam.pipeline import optimize_with_sightings
from slam.simulation import simulate
from tests.benchmarks.metric import Metric, told, within

SEEDS = (0, 1, 2, 3, 4)
BAND = (0.85, 1.15)
"""Too good is a bug, too."""


@dataclass(frozen=True)
class Run:
    """One seed."""

    error_m: float
    bound_m: float
    told_m: float
    """What the estimate's own covariances expect."""


def measure() -> list[Metric]:
    """Over all seeds together: single flights scatter, since their errors are few and long."""
    runs = [run(seed) for seed in SEEDS]
    listed = ", ".join(f"{1e3 * r.error_m:.2f} over {1e3 * r.bound_m:.2f} mm" for r in runs)
    error, bound, own = (
        float(np.sqrt(np.mean(np.square(figures))))
        for figures in zip(*((r.error_m, r.bound_m, r.told_m) for r in runs), strict=True)
    )
    return [
        within(f"{len(runs)} seeds: position error over its bound", error / bound, "x", BAND, listed),
        told("told uncertainty over the bound", own / bound, "x"),
    ]


def run(seed: int) -> Run:
    """Fly, map, and compare with the truth and the bound."""
    flight = simulate("figure_eight", seed)
    estimate, sightings = optimize_with_sightings(flight)
    own = np.trace(estimate.covariances[:, 3:, 3:], axis1=1, axis2=2)
    return Run(
        evaluate(estimate, flight).ate_m.rmse,
        cramer_rao(flight, estimate, sightings).position_rmse_m,
        float(np.sqrt(own.mean())),
    )
