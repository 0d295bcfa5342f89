"""The paper's square, flown once and mapped in three ways; tables 1 and 2 differ in the pictures alone."""

from __future__ import annotations

from collections.abc import Sequence

from slam.estimate import Estimate
from slam.experiments.canvas import Canvas, paint
from slam.experiments.experiment import Row, Spread, Trial, spread
from slam.experiments.stitching import LARGEST, consecutive, landmark_errors, placed
from slam.flight import Flight
from slam.pipeline import optimize
from slam.simulation import simulate

PAIRS = ("A-B", "B-C", "C-D", "D-A", "B-D")
CONSECUTIVE, KEYFRAMES, GRAPH = "chain of pictures, 6.67 Hz", "chain of keyframes", "pose graph"
WAYS = (CONSECUTIVE, KEYFRAMES, GRAPH)


def mapped(recipe: str, seed: int, draw: bool) -> tuple[dict[str, float], dict[str, Canvas]]:
    """Errors in percent as ``WAY/PAIR``, and the drawn maps of the two chains."""
    flight = simulate(recipe, seed)
    estimate = optimize(flight)
    figures: dict[str, float] = {}
    canvases = {}
    for way, made in _ways(estimate, flight).items():
        errors = landmark_errors(made, flight)
        figures |= {f"{way}/{pair}": percent for pair, percent in errors.percent.items()}
        if draw and way != GRAPH:
            canvases[way] = paint(made, flight, errors)
    return figures, canvases


def _ways(estimate: Estimate, flight: Flight) -> dict[str, Estimate]:
    return {
        CONSECUTIVE: consecutive(flight, estimate),
        KEYFRAMES: placed(estimate, estimate.chain_w_T_b),
        GRAPH: estimate,
    }


def rows(trials: Sequence[Trial], prefix: str, paper: dict[str, dict[str, float]]) -> tuple[Row, ...]:
    """The largest error and each pair's, the paper's ``paper[column][pair]`` beside ours."""

    def row(pair: str) -> Row:
        theirs = {
            column: max(errors.values()) if pair == LARGEST else errors[pair]
            for column, errors in paper.items()
        }
        return Row(
            f"{pair} error" if pair == LARGEST else pair,
            "%",
            theirs,
            {way: spread(trials, f"{prefix}{way}/{pair}") for way in WAYS},
        )

    return tuple(row(pair) for pair in (LARGEST, *PAIRS))


def largest(trials: Sequence[Trial], way: str, prefix: str = "") -> Spread:
    """The largest landmark error of a way over the trials."""
    return spread(trials, f"{prefix}{way}/{LARGEST}")
