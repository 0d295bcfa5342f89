"""Landmark errors of one flight mapped with several methods: tables 1 to 4."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.experiments.drawn_map import DrawnMap, paint, show
from slam.experiments.experiment import Row, SeedStatistics, Trial, over_seeds
from slam.experiments.stitching import LARGEST, consecutive, landmark_errors, placed
from slam.mapping.pipeline import optimize
from slam.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONSECUTIVE, KEYFRAMES, GRAPH = "chain of pictures, 6.67 Hz", "chain of keyframes", "pose graph"
WAYS = (CONSECUTIVE, KEYFRAMES, GRAPH)


def mapped(recipe: str, seed: int, draw: bool) -> tuple[dict[str, float], dict[str, DrawnMap]]:
    """Fly a recipe and map it: errors of all methods, and the drawn maps of the two chains."""
    flight = simulate(recipe, seed)
    maps = in_all_ways(optimize(flight), flight)
    return errors_of(maps, flight, (CONSECUTIVE, KEYFRAMES) if draw else ())


def in_all_ways(estimate: Estimate, flight: Flight) -> dict[str, Estimate]:
    """Map a flight by the paper's chain of pictures, the chain of our keyframes, and the pose graph."""
    return {
        CONSECUTIVE: consecutive(flight, estimate),
        KEYFRAMES: placed(estimate, estimate.chain_w_T_b),
        GRAPH: estimate,
    }


def errors_of(
    maps: Mapping[str, Estimate], flight: Flight, drawn: Sequence[str] = ()
) -> tuple[dict[str, float], dict[str, DrawnMap]]:
    """Return the errors in percent as ``WAY/PAIR``, and the maps that are to be drawn."""
    figures: dict[str, float] = {}
    canvases = {}
    for way, made in maps.items():
        errors = landmark_errors(made, flight)
        figures |= {f"{way}/{pair}": percent for pair, percent in errors.percent.items()}
        if way in drawn:
            canvases[way] = paint(made, flight, errors)
    return figures, canvases


def rows(
    trials: Sequence[Trial],
    paper: Mapping[str, Mapping[str, float]],
    ways: Sequence[str] = WAYS,
    prefix: str = "",
) -> tuple[Row, ...]:
    """Rows of the largest error and each pair's error, the paper's ``paper[column][pair]`` and ours."""

    def row(pair: str) -> Row:
        theirs = {
            column: max(errors.values()) if pair == LARGEST else errors[pair]
            for column, errors in paper.items()
        }
        ours = {way: over_seeds(trials, f"{prefix}{way}/{pair}") for way in ways}
        return Row(f"{pair} error" if pair == LARGEST else pair, "%", theirs, ours)

    return tuple(row(pair) for pair in (LARGEST, *next(iter(paper.values()))))


def show_maps(panels: Iterable[Axes], trial: Trial, titles: Mapping[str, str], prefix: str = "") -> None:
    """Draw the maps of some methods (``titles`` by method), each with its largest error."""
    for axes, (way, title) in zip(panels, titles.items(), strict=True):
        percent = trial.figures[f"{prefix}{way}/{LARGEST}"]
        show(axes, trial.drawing[way], f"{title}: largest error {percent:.2f} %")


def largest(trials: Sequence[Trial], way: str, prefix: str = "") -> SeedStatistics:
    """Return the largest landmark error of a method over the trials."""
    return over_seeds(trials, f"{prefix}{way}/{LARGEST}")
