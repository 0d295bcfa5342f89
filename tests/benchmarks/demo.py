"""Figure-eight demo over several seeds: landmark errors, loop gap, consistency."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slam.cli.demo import DEMO_RECIPE
from slam.evaluation import Evaluation, evaluate
from slam.evaluation.landmarks import PerMap
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from tests.benchmarks.metric import Metric, at_least, at_most, reported, within

SEEDS = (0, 1, 2, 3, 4)
LARGEST_PERCENT, GAP_M, GAIN = 0.5, 0.010, 10.0


def measure() -> list[Metric]:
    """Return the figures of seed 0, then of all seeds."""
    runs = [evaluated(seed) for seed in SEEDS]
    return [*one(runs[0]), *several(runs)]


def evaluated(seed: int) -> Evaluation:
    """Simulate, map and compare with the truth."""
    flight = simulate(DEMO_RECIPE, seed)
    return evaluate(optimize(flight), flight)


def largest_percent(evaluation: Evaluation) -> PerMap:
    """Errors of all named distances, for each method of mapping."""
    rows = [row.error_percent for row in evaluation.landmarks]
    return PerMap(*(max(getattr(row, way) for row in rows) for way in ("chain", "odometry", "loops")))


def gain(evaluation: Evaluation) -> float:
    """Return the largest landmark error of the map without loops over that of the map."""
    largest = largest_percent(evaluation)
    return largest.odometry / largest.loops


def gap_m(evaluation: Evaluation) -> PerMap:
    """Errors of the A-E gap."""
    return next(gap.error_m for gap in evaluation.loop_gaps if gap.name == "A-E")


def one(run: Evaluation) -> list[Metric]:
    """Return the figures of the default recipe and seed, as ``slam demo`` shows them."""
    largest, gap = largest_percent(run), gap_m(run)
    assert run.nees is not None
    assert run.loops is not None
    pose = run.nees.pose
    return [
        reported("seed 0: largest landmark error, chain of homographies", largest.chain, "%"),
        reported("seed 0: largest landmark error, optimized without loops", largest.odometry, "%"),
        at_most("seed 0: largest landmark error, with loops", largest.loops, "%", LARGEST_PERCENT),
        at_least("seed 0: largest landmark error without loops over that with loops", gain(run), "x", GAIN),
        reported("seed 0: A-E gap error, chain of homographies", gap.chain, "m"),
        reported("seed 0: A-E gap error, optimized without loops", gap.odometry, "m"),
        at_most("seed 0: A-E gap error, with loops", gap.loops, "m", GAP_M),
        reported(
            "seed 0: position error (ATE)", run.ate_m.rmse, "m", "first keyframe's position and yaw aligned"
        ),
        within(
            "seed 0: mean NEES of poses", pose.mean, "", (pose.lower95, pose.upper95), "95 % band; 6 expected"
        ),
        reported("seed 0: loop precision", run.loops.precision, ""),
        reported("seed 0: loop recall", run.loops.recall, ""),
    ]


def several(runs: list[Evaluation]) -> list[Metric]:
    """Return the median and the worst over the seeds."""
    metrics = []
    asked: list[tuple[str, str, Callable[[Evaluation], float], float | None]] = [
        ("largest landmark error, chain of homographies", "%", lambda e: largest_percent(e).chain, None),
        ("largest landmark error, optimized without loops", "%", lambda e: largest_percent(e).odometry, None),
        ("largest landmark error, with loops", "%", lambda e: largest_percent(e).loops, LARGEST_PERCENT),
        ("A-E gap error, chain of homographies", "m", lambda e: gap_m(e).chain, None),
        ("A-E gap error, with loops", "m", lambda e: gap_m(e).loops, GAP_M),
        ("position error (ATE)", "m", lambda e: e.ate_m.rmse, None),
    ]
    for key, unit, figure, limit in asked:
        values = np.array([figure(run) for run in runs])
        metrics.append(reported(f"{len(runs)} seeds, median: {key}", float(np.median(values)), unit))
        worst = f"{len(runs)} seeds, worst: {key}"
        metrics.append(
            reported(worst, values.max(), unit)
            if limit is None
            else at_most(worst, values.max(), unit, limit)
        )
    worst = f"{len(runs)} seeds, least: largest landmark error without loops over that with loops"
    metrics.append(at_least(worst, min(gain(run) for run in runs), "x", GAIN))
    poses = [run.nees.pose for run in runs if run.nees is not None]
    listed = ", ".join(f"{p.mean:.2f} in {p.lower95:.2f}-{p.upper95:.2f}" for p in poses)
    inside = sum(p.consistent for p in poses)
    metrics.append(reported(f"{len(runs)} seeds: mean NEES inside its 95 % band", inside, "", listed))
    return metrics
