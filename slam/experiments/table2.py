"""Table 2 and figure 6: the same square with the paper's white-balance filter on its pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import wilcoxon

from slam.evaluation.paper_values import SQUARE_DRONE_PERCENT, SQUARE_PERCENT, WHITE_BALANCE_PERCENT
from slam.experiments.experiment import (
    DRONE,
    SIMULATOR,
    Conclusion,
    Experiment,
    Row,
    SeedStatistics,
    Trial,
    column,
    text,
    verdict,
)
from slam.experiments.maps import CONSECUTIVE, GRAPH, KEYFRAMES, WAYS, largest, mapped, rows, show_maps
from slam.experiments.stitching import LARGEST

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WITH, _WITHOUT = "with/", "without/"
_UNLIKELY = 0.05


def _trial(seed: int, draw: bool) -> Trial:
    """The same flight twice: the seed's hold noise and picture noise are the same in both."""
    with_filter, canvases = mapped("square_white_balance", seed, draw)
    without, _ = mapped("square", seed, False)
    figures = {f"{_WITH}{key}": value for key, value in with_filter.items()}
    figures |= {f"{_WITHOUT}{key}": value for key, value in without.items()}
    for way in WAYS:
        figures[f"growth/{way}"] = with_filter[f"{way}/{LARGEST}"] / without[f"{way}/{LARGEST}"]
    return Trial(seed, figures, canvases)


def _conclude(trials: tuple[Trial, ...]) -> Conclusion:
    theirs = max(WHITE_BALANCE_PERCENT.values()) / max(SQUARE_PERCENT.values())
    growth = {way: SeedStatistics.of(column(trials, f"growth/{way}")) for way in WAYS}
    chance = {way: _chance(column(trials, f"growth/{way}")) for way in WAYS}
    with_filter, without = (largest(trials, CONSECUTIVE, prefix) for prefix in (_WITH, _WITHOUT))
    pictures = growth[CONSECUTIVE]
    grows = pictures.median > 1 and chance[CONSECUTIVE] < _UNLIKELY
    reason = (
        f"the filter changes the largest error of the chain of pictures from {text(without, '%')} to "
        f"{text(with_filter, '%')}. On the same flight the factor is {text(pictures)} (signed-rank test: p "
        f"= {chance[CONSECUTIVE]:.2g}); the paper's factor is {theirs:.1f}. The factor of the chain of "
        f"keyframes is {text(growth[KEYFRAMES])} (p = {chance[KEYFRAMES]:.2g}). That of the pose "
        f"graph is {text(growth[GRAPH])}. The errors stay small because descriptors normalise contrast "
        "and the robust fit rejects wrong matches. Brightness costs our stitcher matches more than "
        "accuracy."
    )
    paper = {DRONE: SQUARE_DRONE_PERCENT, SIMULATOR: WHITE_BALANCE_PERCENT}
    table = rows(trials, paper, prefix=_WITH)
    factor = Row("largest error, with the filter over without", "1", {SIMULATOR: theirs}, growth)
    alike = grows and pictures.lower95 <= theirs <= pictures.upper95
    return Conclusion((table[0], factor, *table[1:]), verdict(alike, partly=grows), reason)


def _chance(ratios: list[float]) -> float:
    """Probability of at least this growth if there were none: one-sided signed-rank test on the
    logarithms."""
    known = np.log([ratio for ratio in ratios if np.isfinite(ratio) and ratio > 0])
    return float(wilcoxon(known, alternative="greater").pvalue) if len(known) > 1 else 1.0


def _draw(figure: Figure, trials: tuple[Trial, ...]) -> None:
    panels = figure.subplots(1, 2)
    show_maps(panels, trials[0], {way: f"{way}, white balance" for way in (CONSECUTIVE, KEYFRAMES)}, _WITH)


EXPERIMENT = Experiment(
    name="table2",
    title="The square with white balance that varies: error of the map",
    source="section 4.1, table 2, figure 6",
    trial=_trial,
    conclude=_conclude,
    draw=_draw,
    size_inches=(11.0, 5.8),
)
