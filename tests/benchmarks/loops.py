"""Loop closure on the figure eight, and under changing light.

Recall is that of pairs after verification, before the first false one: ten candidates a keyframe, nothing
known of the poses.
"""

from __future__ import annotations

from dataclasses import replace

from slam.evaluation.loops import LoopEvaluation, evaluate_loops
from slam.evaluation.loops.comparison import MethodScore
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_least, reported

LIGHT = {"gain": 0.15, "gamma": 0.30, "tau": 0.02}


def measure() -> list[Metric]:
    """Return the recall at full precision of ours and of other methods."""
    eight = load_recipe("figure_eight")
    light = replace(eight, model=eight.model.with_term("exposure_variation", **LIGHT))
    return [
        *beside("figure eight", evaluate_loops(simulate(eight, 0)), 95),
        *beside("white-balance noise", evaluate_loops(simulate(light, 0)), 85),
    ]


def beside(name: str, result: LoopEvaluation, asked_percent: float) -> list[Metric]:
    """Return one line for each method."""
    ours, *others = result.methods
    recall = 100 * ours.after_verification.full_precision_recall
    key = f"{name}: recall at 100 % precision after verification, ours"
    metrics = [at_least(key, recall, "%", asked_percent, areas(ours))]
    for method in others:
        value = 100 * method.after_verification.full_precision_recall
        metrics.append(reported(f"{name}: the same, {method.name}", value, "%", areas(method)))
    kept = result.stages[-1].counts
    share = 100 * kept.true / result.all_true_pairs
    metrics.append(reported(f"{name}: true loops in the map", share, "%", f"{kept.false} false"))
    return metrics


def areas(method: MethodScore) -> str:
    """Return the areas under precision over recall."""
    after = f"area {method.after_verification.area:.3f}"
    return after if method.candidates is None else f"{after}; over candidates {method.candidates.area:.3f}"
