"""Repetitive floors: 50 flights over nine equal copies of the paper's tile, with equal weathering and no
marks.

A loop between two places one tile apart verifies as well as a true one. Flights differ in floor, start,
height, shape and heading: the figure eight, a random closed path flown twice, there and back, a lawn-mower
pattern with a crossing, a closed path at changing heights.

``python -m tests.benchmarks.aliased FIRST LAST`` runs some of them and prints one line of JSON each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.manoeuvre import Manoeuvre, WayPoint
from slam.simulation.recipe import load_recipe
from tests.benchmarks.alone import print_alone
from tests.benchmarks.metric import Metric, at_least, at_most, reported

FLIGHTS = 50
WAYS = ("eight", "round twice", "there and back", "lines", "heights")
FLOOR_M = (0.2, 4.3)
LEAST_LEG_M = 1.0


@dataclass(frozen=True)
class Aliased:
    """Result of one flight."""

    seed: int
    way: str
    false_kept: int
    true_kept: int
    true_pairs: int
    refused: int
    """Number of pairs with a valid homography that the poses rejected."""
    error_m: float
    """RMS error of the positions, in metres."""
    placed: float
    """Share of the keyframes in the main map."""


def measure() -> list[Metric]:
    """False and true loops in the maps of all flights."""
    flown = [fly(seed) for seed in range(FLIGHTS)]
    with_loops = [f for f in flown if f.true_pairs]
    worst = min(with_loops, key=lambda f: f.true_kept / f.true_pairs)
    refused = sum(f.refused for f in flown)
    pairs = f"{sum(f.true_kept for f in flown)} of {sum(f.true_pairs for f in flown)} true ones are kept"
    furthest = max(flown, key=lambda f: f.error_m)
    return [
        at_most(
            f"false loops in the maps of {FLIGHTS} flights", sum(f.false_kept for f in flown), "", 0,
            f"{pairs}; {refused} pairs with a valid homography were rejected by the poses",
        ),
        at_least(
            "least share of true loops kept in a flight", 100 * worst.true_kept / worst.true_pairs, "%", 50,
            f"flight {worst.seed}, {worst.way}",
        ),
        reported("largest error of a map", 1e3 * furthest.error_m, "mm", f"flight {furthest.seed}"),
        reported("least share of keyframes placed", 100 * min(f.placed for f in flown), "%"),
    ]  # fmt: skip


def fly(seed: int) -> Aliased:
    """Simulate one flight and map it."""
    flight = repeated(seed)
    estimate = optimize(flight)
    evaluation = evaluate(estimate, flight)
    assert evaluation.loops is not None
    assert evaluation.ate_m is not None
    return Aliased(
        seed,
        WAYS[seed % len(WAYS)],
        evaluation.loops.false_kept,
        evaluation.loops.true_kept,
        evaluation.loops.true_pairs,
        sum("implausible" in loop.reason for loop in estimate.loops),
        evaluation.ate_m.rmse,
        float((estimate.component == 0).mean()),
    )


def repeated(seed: int, corners: int = 6, rate_hz: float = 3.0) -> Flight:
    """Simulate a flight over a repetitive floor."""
    eight = load_recipe("figure_eight")
    assert eight.camera is not None
    rng = np.random.default_rng((seed, 3))
    world = replace(eight.world, repeat=True, mark_diameter_m=0.0, seed=int(rng.integers(1000)))
    recipe = replace(
        eight,
        name=f"repeated floor {seed}",
        landmark_pairs=(),
        gaps=(),
        world=world,
        maneuver=way(eight.maneuver, WAYS[seed % len(WAYS)], seed, corners, rng),
        camera=replace(eight.camera, rate_hz=rate_hz),
    )
    return simulate(recipe, seed)


def way(eight: Manoeuvre, shape: str, seed: int, corners: int, rng: np.random.Generator) -> Manoeuvre:
    """Return the way points of a flight. Even flights keep their heading; odd ones turn along the path."""
    height_m = float(rng.uniform(0.6, 1.0))
    if shape == "eight":
        return replace(eight, height_m=height_m)
    points: list[WayPoint] = []
    if shape == "lines":
        lines = np.linspace(*FLOOR_M, 4).tolist()
        for k, y in enumerate(lines):
            points += [(x, y) for x in (FLOOR_M if k % 2 == 0 else FLOOR_M[::-1])]
        points.append(_anywhere(rng))
    else:
        points.append(_anywhere(rng))
        while len(points) < corners:
            if np.hypot(*np.subtract(there := _anywhere(rng), points[-1])) > LEAST_LEG_M:
                points.append(there)
    if shape == "round twice":
        points += points[:2]
    if shape == "there and back":
        points = [*points[:5], *points[3::-1]]
    if shape == "heights":
        points = [(*point, float(rng.uniform(0.6, 1.2))) for point in points]
        points.append(points[0])
    heading_deg = float(rng.uniform(-180, 180)) if seed % 2 == 0 else 0.0
    return replace(
        eight, way_points=tuple(points), height_m=height_m,
        heading="along_path" if seed % 2 else "fixed", heading_deg=heading_deg,
    )  # fmt: skip


def _anywhere(rng: np.random.Generator) -> tuple[float, float]:
    x, y = rng.uniform(*FLOOR_M, 2).tolist()
    return x, y


if __name__ == "__main__":
    print_alone(fly)
