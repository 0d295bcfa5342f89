"""The path from above, coloured by time: one panel a lap, so that laps over the same ground can be told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.estimate import Estimate
from slam.core.plot_style import BLUE, GREY, PALE_GREY, grid, ground_labels, png
from slam.evaluation.aligned_maps import chain_on_result
from slam.report.facts import is_placed
from slam.report.gaps import Gap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_MOST_PANELS = 6
"""Three rows of two panels fill a page."""
_WIDTH_IN = 6.6
_LEAST_SHAPE, _MOST_SHAPE = 0.4, 1.0
"""Height of a panel over its width: the shape of the path, within limits."""


def path_over_time(estimate: Estimate, gaps: Sequence[Gap] = ()) -> bytes:
    """Draw stretches of equal length of the path from above, each before the whole path in pale grey.

    The plain chain is drawn for the same stretch. Over ``gaps`` the path is dotted.
    """
    from matplotlib.figure import Figure

    known = np.flatnonzero(is_placed(estimate))
    xy, chain = estimate.w_T_b[:, :2, 3], chain_on_result(estimate)[:, :2, 3]
    stretches = _stretches(xy, known)
    columns = min(2, len(stretches))
    rows = -(-len(stretches) // columns)
    limits = _limits(np.vstack([xy[known], chain[known]]))
    shape = float(np.divide(*np.ptp(limits, axis=0)[::-1]))
    figure = Figure(
        figsize=(_WIDTH_IN, rows * shape * 0.85 * _WIDTH_IN / columns + 0.9), dpi=150, layout="constrained"
    )
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    time = estimate.stamps_s - estimate.stamps_s[known[0]]
    labels = ground_labels(estimate.origin is not None, estimate.metric)
    for axes, stretch in zip(panels.ravel(), stretches, strict=False):
        axes.plot(*xy[known].T, color=PALE_GREY, linewidth=0.8, label="whole path" if columns > 1 else None)
        axes.plot(*chain[stretch].T, color=GREY, linewidth=0.9, linestyle=(0, (5, 3)), label="chain alone")
        colours = _coloured(axes, estimate, stretch, time, gaps)
        first, last = known[0], known[-1]
        axes.plot(
            *xy[first], "o", color=BLUE, mfc="none", ms=10, mew=1.8, zorder=5, label="start", linestyle=""
        )
        axes.plot(*xy[last], "s", color=BLUE, ms=6, zorder=4, label="end", linestyle="")
        axes.set(xlim=limits[:, 0], ylim=limits[:, 1])
        axes.set_aspect("equal", adjustable="box")  # all panels share their limits, which have this shape
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(colors="#444c56", labelsize=9)
        grid(axes)
        if columns > 1:
            axes.set_title(f"{time[stretch[0]]:.0f} to {time[stretch[-1]]:.0f} s", fontsize=10)
    for axes in panels.ravel()[len(stretches) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel(labels[0])
    for axes in panels[:, 0]:
        axes.set_ylabel(labels[1])
    _legends(figure, panels, colours)
    if columns > 1:
        figure.draw_without_rendering()  # titles have their place only after a first layout
    return png(figure)


def laps(xy: Array) -> int:
    """Return how often a path (n, 2) is as long as a way around the rectangle that holds it, at least 1."""
    around = 2.0 * float(np.ptp(xy, axis=0).sum())
    length = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    return max(1, round(length / around)) if around > 0 else 1


def _limits(xy: Array) -> Array:
    """Return the least and largest coordinates (2, 2) of a panel, with a margin and a shape within limits."""
    least, most = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    width, height = np.maximum(most - least, 1e-9)
    size = np.array([max(width, height / _MOST_SHAPE), max(height, _LEAST_SHAPE * width)])
    return np.asarray((least + most) / 2 + np.outer([-0.55, 0.55], size))


def _stretches(xy: Array, known: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the placed keyframes of each stretch; the last one of a stretch begins the next."""
    count = min(laps(xy[known]), _MOST_PANELS)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy[known], axis=0), axis=1))])
    ends = np.searchsorted(along, along[-1] * np.arange(1, count) / count).tolist()
    return [
        known[begin : end + 1]
        for begin, end in zip([0, *ends], [*ends, len(known) - 1], strict=True)
        if end > begin
    ] or [known]


def _coloured(
    axes: Axes, estimate: Estimate, stretch: NDArray[np.int64], time: Array, gaps: Sequence[Gap]
) -> object:
    """Draw the path of a stretch in the colours of its times, dotted over gaps, and return the colours."""
    from matplotlib.collections import LineCollection

    xy, pairs = estimate.w_T_b[:, :2, 3], list(zip(stretch[:-1].tolist(), stretch[1:].tolist(), strict=True))
    pairs = [(i, j) for i, j in pairs if estimate.component[i] == estimate.component[j]]
    over = {(gap.i, gap.j) for gap in gaps}
    drawn = LineCollection(
        [(xy[i], xy[j]) for i, j in pairs],
        linewidths=[1.6 if pair in over else 2.6 for pair in pairs],
        linestyles=[(0, (1, 1.5)) if pair in over else "-" for pair in pairs],
        cmap="viridis", zorder=3,
    )  # fmt: skip
    drawn.set_array(np.array([(time[i] + time[j]) / 2 for i, j in pairs]))
    drawn.set_clim(float(np.nanmin(time)), float(np.nanmax(time)))
    axes.add_collection(drawn)
    return drawn


def _legends(figure: Figure, panels: NDArray[np.object_], colours: object) -> None:
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    bar = figure.colorbar(colours, ax=panels, shrink=0.8, aspect=30, pad=0.02)  # type: ignore[arg-type]
    bar.set_label("time since the start [s]", fontsize=10)
    bar.ax.tick_params(labelsize=9)
