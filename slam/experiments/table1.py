"""Table 1 and figure 5: the square of four landmarks, mapped by the chain of homographies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slam.evaluation.paper_values import SQUARE_DRONE_PERCENT, SQUARE_PERCENT
from slam.experiments.chain_comparison import ChainComparison
from slam.experiments.experiment import DRONE, SIMULATOR, Conclusion, Experiment, Trial, text, verdict
from slam.experiments.maps import CONSECUTIVE, GRAPH, KEYFRAMES, largest, mapped, rows, show_maps

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _trial(seed: int, draw: bool) -> Trial:
    figures, canvases = mapped("square", seed, draw)
    return Trial(seed, figures, canvases)


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    theirs = max(SQUARE_PERCENT.values())
    ours, pictures, graph = (largest(trials, way) for way in (KEYFRAMES, CONSECUTIVE, GRAPH))
    chained = ChainComparison(theirs, pictures)
    reason = (
        "the paper's method, which chains every picture that its computer could process, leaves a largest "
        f"landmark error of {text(pictures, '%')} in our simulator, and {theirs} % in the paper's: "
        f"{chained.words('table 1')}"
        f"Our chain of keyframes leaves {text(ours, '%')}, and the pose graph {text(graph, '%')}."
    )
    paper = {DRONE: SQUARE_DRONE_PERCENT, SIMULATOR: SQUARE_PERCENT}
    return Conclusion(rows(trials, paper), verdict(chained.same, partly=chained.alike), reason)


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
