"""Table 1 and figure 5: the square of four landmarks, mapped by the chain of homographies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slam.evaluation.paper_values import SQUARE_DRONE_PERCENT, SQUARE_PERCENT
from slam.experiments.experiment import DRONE, SIMULATOR, Conclusion, Experiment, Trial, text, verdict
from slam.experiments.maps import CONSECUTIVE, GRAPH, KEYFRAMES, largest, mapped, rows, show_maps

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _trial(seed: int, draw: bool) -> Trial:
    figures, canvases = mapped("square", seed, draw)
    return Trial(seed, figures, canvases)


ALIKE = 2.0
"""Largest factor, up or down, between the paper's error and ours for which the two agree in part."""


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    theirs = max(SQUARE_PERCENT.values())
    ours, pictures, graph = (largest(trials, way) for way in (KEYFRAMES, CONSECUTIVE, GRAPH))
    same = pictures.lower95 <= theirs <= pictures.upper95
    factor = theirs / pictures.median
    reason = (
        "the paper's method, which chains every picture that its computer could process, leaves a largest "
        f"landmark error of {text(pictures, '%')} in our simulator, and {theirs} % in the paper's: "
        f"{_factor(factor)}. {_cause(same, factor)}"
        f"Our chain of keyframes leaves {text(ours, '%')}, and the pose graph {text(graph, '%')}."
    )
    paper = {DRONE: SQUARE_DRONE_PERCENT, SIMULATOR: SQUARE_PERCENT}
    return Conclusion(rows(trials, paper), verdict(same, partly=1 / ALIKE <= factor <= ALIKE), reason)


def _factor(factor: float) -> str:
    return f"{factor:.1f} times ours" if factor >= 1 else f"ours is {1 / factor:.1f} times as large"


def _cause(same: bool, factor: float) -> str:
    """Say why a much better map does not repeat the paper's."""
    if same or factor < 1:
        return ""
    return (
        "Ours is a better map, not the paper's, so table 1 is surpassed and not repeated. Possible causes "
        "are the pictures of the paper's game engine and its features (SURF), which we do not have. "
    )


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    show_maps(figure.subplots(1, 2), trials[0], {way: way for way in (CONSECUTIVE, KEYFRAMES)})


EXPERIMENT = Experiment(
    name="table1",
    title="The square: error of the map",
    source="section 4.1, table 1, figures 4 and 5",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(11.0, 5.8),
)
