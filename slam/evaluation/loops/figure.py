"""Figure ``loops.png``: precision over recall, pairs that pass each stage, and the loops on the map."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    escape_math,
    grid,
    panel_legend_below,
    png,
)
from slam.evaluation.loops.comparison import EXHAUSTIVE, HISTOGRAM, OURS, WORDS, LoopEvaluation, MethodScore
from slam.evaluation.loops.reference import FALSE, TRUE, Pair

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.evaluation.loops.curve import Curve

_STYLE = {
    OURS: (BLUE, "-", 2.4),
    WORDS: (ORANGE, "-", 1.5),
    HISTOGRAM: (GREY, "-", 1.5),
    EXHAUSTIVE: ("black", ":", 1.8),
}
_MOST_LINES = 600
"""Largest number of loops of a kind drawn on the map; more would hide it."""


def draw(evaluation: LoopEvaluation) -> bytes:
    """Draw the figure as PNG bytes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 11.0), dpi=110, layout="constrained")
    (candidates, verified), (stages, top) = figure.subplots(2, 2)
    figure.suptitle(
        f"{escape_math(evaluation.name)}: {evaluation.true_pairs} true loops among {evaluation.pairs} pairs "
        f"of {evaluation.compared} keyframes"
    )
    _curves(candidates, "Candidates: all pairs by similarity", evaluation, lambda m: m.candidates)
    _curves(
        verified,
        f"After verification: the {evaluation.neighbours} most similar of each, by inliers",
        evaluation,
        lambda m: m.after_verification,
    )
    _stages(stages, evaluation)
    _map(top, evaluation)
    return png(figure)


def _curves(
    axes: Axes, title: str, evaluation: LoopEvaluation, curve_of: Callable[[MethodScore], Curve | None]
) -> None:
    for method in evaluation.methods:
        curve = curve_of(method)
        if curve is None:
            continue
        color, line, width = _STYLE[method.name]
        label = method.name
        if evaluation.true_pairs:
            first = 100 * curve.full_precision_recall
            label += f": {first:.0f} % before the first false loop, average precision {curve.area:.3f}"
        recall = np.concatenate([[0.0], curve.recall]) if len(curve.recall) else curve.recall
        precision = np.concatenate([curve.precision[:1], curve.precision])
        axes.plot(recall, precision, line, color=color, lw=width, label=label, drawstyle="steps-pre")
        axes.plot(recall[-1:], precision[-1:], "o", color=color, ms=5)
    if not evaluation.true_pairs:
        axes.text(0.5, 0.5, "no true loop in this flight", ha="center", color=GREY)
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.04), title=title)
    axes.set_xlabel("recall: share of all true loops that are accepted")
    axes.set_ylabel("precision: share of accepted pairs that are true")
    grid(axes)
    panel_legend_below(axes, 1)


def _stages(axes: Axes, evaluation: LoopEvaluation) -> None:
    names = [f"{stage.name}" for stage in evaluation.stages]
    place = np.arange(len(names))
    for offset, kind, color in ((-0.2, "true", GREEN), (0.2, "false", VERMILLION)):
        count = np.array([getattr(stage.counts, kind) for stage in evaluation.stages])
        bars = axes.barh(place + offset, count, 0.36, color=color, label=f"{kind} loops")
        axes.bar_label(bars, [str(c) for c in count], padding=3, fontsize=9)
    axes.set_xscale("symlog", linthresh=10)
    axes.xaxis.set_major_formatter("{x:g}")
    most = max((max(s.counts.true, s.counts.false) for s in evaluation.stages), default=1)
    axes.set_xlim(0, 3 * max(most, 10))
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.set_xlabel("pairs")
    axes.set_title(
        f"Our pipeline on all {evaluation.keyframes} keyframes ({evaluation.all_true_pairs} true loops)"
    )
    panel_legend_below(axes, 2)


def _map(axes: Axes, evaluation: LoopEvaluation) -> None:
    reference = evaluation.reference
    x, y = reference.position_m.T
    axes.plot(x, y, "-", color=GREY, lw=1, zorder=1)
    axes.plot(x, y, ".", color="black", ms=3, zorder=2, label="keyframes")
    true = [pair for pair, label in _labelled(list(reference.overlap), evaluation) if label == TRUE]
    kept = _labelled(list(evaluation.kept), evaluation)
    right = {pair for pair, label in kept if label == TRUE}
    for pairs, color, label, width in (
        ([p for p in true if p not in right], ORANGE, "true loops missed", 0.7),
        (sorted(right), GREEN, "true loops in the map", 0.9),
        ([p for p, label in kept if label == FALSE], VERMILLION, "false loops in the map", 1.8),
    ):
        for pair in pairs[:: max(1, len(pairs) // _MOST_LINES)]:
            axes.plot(x[list(pair)], y[list(pair)], "-", color=color, lw=width, zorder=3)
        axes.plot([], [], "-", color=color, lw=2, label=f"{label}: {len(pairs)}")
    kind = "truth" if reference.kind == "truth" else "GPS"
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"Loops on the {kind}")
    axes.set_aspect("equal", adjustable="datalim")
    panel_legend_below(axes, 2)


def _labelled(pairs: list[Pair], evaluation: LoopEvaluation) -> list[tuple[Pair, int]]:
    return list(zip(pairs, evaluation.reference.labels(pairs).tolist(), strict=True))
