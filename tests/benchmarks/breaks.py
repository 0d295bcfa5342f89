"""Segments without features: flights without pictures once or twice for 1 to 3 s, half of them over
repetitive floors.

Behind a break the first picture may match the last one before it with another copy of the floor; only the
instruments can decide. Paths are those of `tests.benchmarks.aliased`; half of the flights have no velocity
stream.

``python -m tests.benchmarks.breaks FIRST LAST`` runs some of them and prints one line of JSON each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.mapping.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.aliased import WAYS, way
from tests.benchmarks.alone import print_alone
from tests.benchmarks.metric import Metric, at_least, at_most, reported

FLIGHTS = 24
WIDTH, HEIGHT = 176, 144
TILE_M = 1.6
BREAK_S = (1.0, 3.0)
WITHIN = (0.15, 0.8)
"""Shares of the flight between which a break begins."""
SECOND = 0.3
"""Share of the flights with two breaks."""


@dataclass(frozen=True)
class Broken:
    """Result of one flight."""

    seed: int
    repeats: bool
    placed: float
    """Share of the keyframes in the main map."""
    bridges: int
    false_kept: int
    error_m: float
    """RMS error of the positions, in metres."""
    nees: float
    in_band: bool
    """Whether the mean NEES is in its 95 % band."""


def measure() -> list[Metric]:
    """Whether all parts are joined in one correct map."""
    flown = [fly(seed) for seed in range(FLIGHTS)]
    joined = [f for f in flown if f.placed == 1.0]
    furthest, worst = (max(flown, key=lambda f, key=key: getattr(f, key)) for key in ("error_m", "nees"))
    return [
        at_least("flights whose keyframes are all in one map", len(joined), "", FLIGHTS),
        at_most("maps with errors of half a tile", sum(f.error_m > TILE_M / 2 for f in flown), "", 0),
        reported(f"false loops in the maps of {FLIGHTS} flights", sum(f.false_kept for f in flown), ""),
        reported(
            "largest error of a map", 1e3 * furthest.error_m, "mm",
            f"flight {furthest.seed}, bridged {furthest.bridges} times",
        ),
        reported("largest mean NEES of a map", worst.nees, "", f"flight {worst.seed}; 6 expected"),
        reported(
            "maps whose mean NEES is inside its band", 100 * sum(f.in_band for f in flown) / FLIGHTS, "%"
        ),
    ]  # fmt: skip


def fly(seed: int) -> Broken:
    """Simulate one flight and map it."""
    flight = broken(seed)
    estimate = optimize(flight)
    found = evaluate(estimate, flight)
    assert found.loops is not None
    assert found.nees is not None
    return Broken(
        seed,
        _repeats(seed),
        float((estimate.component == 0).mean()),
        sum(edge.kind == "inertial" for edge in estimate.relative_poses),
        found.loops.false_kept,
        found.ate_m.rmse,
        found.nees.pose.mean,
        found.nees.pose.consistent,
    )


def broken(seed: int) -> Flight:
    """Simulate a flight with one or two breaks."""
    rng = np.random.default_rng((seed, 21))
    eight = load_recipe("figure_eight")
    assert eight.camera is not None
    world = replace(eight.world, seed=int(rng.integers(1000)))
    if _repeats(seed):
        world = replace(world, repeat=True, mark_diameter_m=0.0)
    recipe = replace(
        eight,
        name=f"broken {seed}",
        landmark_pairs=(),
        gaps=(),
        world=world,
        maneuver=way(eight.maneuver, WAYS[seed // 4 % len(WAYS)], seed, 5, rng),
        camera=replace(eight.camera, size_px=(WIDTH, HEIGHT), rate_hz=5.0),
    )
    flight = simulate(recipe, seed)
    assert flight.frames is not None
    assert flight.velocity is not None
    stamps_s, load = flight.frames.stamps_s, flight.frames.load
    blind = np.zeros(len(stamps_s), bool)
    for _ in range(1 + int(rng.random() < SECOND)):
        begin_s = stamps_s[0] + rng.uniform(*WITHIN) * (stamps_s[-1] - stamps_s[0])
        blind |= (stamps_s >= begin_s) & (stamps_s < begin_s + rng.uniform(*BREAK_S))
    grey = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    frames = replace(flight.frames, load=lambda k: grey if blind[k] else load(k))
    # The simulated speed has the nominal scale.
    velocity = replace(flight.velocity, scale_std=0.0) if seed // 2 % 2 == 0 else None
    return replace(flight, frames=frames, velocity=velocity)


def _repeats(seed: int) -> bool:
    return seed % 2 == 0


if __name__ == "__main__":
    print_alone(fly)
