"""Loop closure on the figure eight, with light that changes, and on floors that repeat.

Recall is that of pairs after verification, before the first false one: ten candidates a keyframe, nothing
known of the poses. On the repeated floor, the paper's tile nine times with its wear and without marks,
what verification lets through is ambiguous; there the figure is what reaches the map, over flights of
four pictures a second.
"""

from __future__ import annotations

from dataclasses import replace

from slam.estimate import Estimate
from slam.evaluation import evaluate
from slam.flight import Flight
from slam.loops import LoopEvaluation, evaluate_loops
from slam.loops.evaluation import MethodScore
from slam.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import Recipe, load_recipe
from tests.benchmarks.metric import Metric, at_least, at_most, told

ALIASED_SEEDS = range(6)
LIGHT = {"gain": 0.15, "gamma": 0.30, "tau": 0.02}


def measure() -> list[Metric]:
    """Recall at full precision, ours beside other methods; then floors that repeat."""
    eight = load_recipe("figure_eight")
    light = replace(eight, model=eight.model.with_term("exposure_variation", **LIGHT))
    return [
        *beside("figure eight", evaluate_loops(simulate(eight, 0)), 95),
        *beside("white-balance noise", evaluate_loops(simulate(light, 0)), 85),
        *aliased(eight),
    ]


def beside(name: str, result: LoopEvaluation, asked_percent: float) -> list[Metric]:
    """A line a method."""
    ours, *others = result.methods
    recall = 100 * ours.after_verification.full_precision_recall
    key = f"{name}: recall at 100 % precision after verification, ours"
    metrics = [at_least(key, recall, "%", asked_percent, areas(ours))]
    for method in others:
        value = 100 * method.after_verification.full_precision_recall
        metrics.append(told(f"{name}: the same, {method.name}", value, "%", areas(method)))
    kept = result.stages[-1].counts
    share = 100 * kept.true / result.all_true_pairs
    metrics.append(told(f"{name}: true loops in the map", share, "%", f"{kept.false} false"))
    return metrics


def areas(method: MethodScore) -> str:
    """Areas under precision over recall."""
    after = f"area {method.after_verification.area:.3f}"
    return after if method.candidates is None else f"{after}; over candidates {method.candidates.area:.3f}"


def aliased(eight: Recipe) -> list[Metric]:
    """False and true loops in the map, over the flights."""
    assert eight.camera is not None
    world = replace(eight.world, repeat=True, mark_diameter_m=0.0)
    recipe = replace(eight, world=world, camera=replace(eight.camera, rate_hz=4.0))
    false, recalls, compared = 0, [], 0
    for seed in ALIASED_SEEDS:
        flight = simulate(recipe, seed)
        estimate = optimize(flight)
        scored = kept(estimate, flight)
        false, compared = (
            false + scored[0],
            compared + sum("implausible" in loop.reason for loop in estimate.loops),
        )
        recalls.append(scored[1])
    flights = f"{len(recalls)} flights; {compared} pairs whose homography holds were refused by the poses"
    return [
        at_most("floor that repeats: false loops in the maps", false, "", 0, flights),
        at_least("floor that repeats: least share of true loops kept", 100 * min(recalls), "%", 50),
    ]


def kept(estimate: Estimate, flight: Flight) -> tuple[int, float]:
    """False loops in the map, and the share of true ones that are there."""
    loops = evaluate(estimate, flight).loops
    assert loops is not None
    return loops.false_kept, loops.recall
