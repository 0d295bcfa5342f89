"""Picture of sizes that are not the same throughout: each in each part of each flight."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import BLUE, GREEN, GREY, ORANGE, VERMILLION, grid, png
from slam.core.units import everyday, spaced
from slam.criticism.cause import WIDE
from slam.report.criticism.plain_names import figure, quantity, title_of, with_titles
from slam.report.criticism.segment import Segment
from slam.report.criticism.values import change_of_size
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.criticism import Criticism
    from slam.criticism.verdict.over_time import SizeOverTime

_TITLE = "When sizes change"
LINE_LETTERS, MARKER_LETTERS = 95, 6
"""Letters of the legend that the figure is wide, and those in whose width the marker and the gap stand."""
_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE)
MOST_PANELS = 3
_MARKERS = "osD^v"
"""With four colours they tell twenty flights apart; more of them share these."""


def size_over_time(result: Criticism) -> Segment | None:
    """Return the sizes over time of the parameters that change, the most certain first; None where none
    changes."""
    from matplotlib.figure import Figure

    changing = [series for series in map(_possible, result.changes) if len(series.sizes) > 1]
    if not changing:
        return None
    shown = sorted(changing, key=_certainty, reverse=True)[:MOST_PANELS]
    drawn = Figure(figsize=(7.2, 0.9 + 1.1 * len(shown)), dpi=160, layout="constrained")
    panels = np.ravel(drawn.subplots(len(shown), 1, sharex=True))
    for axes, series in zip(panels, shown, strict=True):
        _draw(axes, series, result)
    panels[-1].set_xlabel("time in the flight [s]", fontsize=9)
    longest = max(len(name) for series in shown for name in series.flights) + MARKER_LETTERS
    columns = max(1, min(4, LINE_LETTERS // longest))
    handles = {
        label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    drawn.legend(
        [*handles.values()], [*handles], loc="outside lower center", ncols=columns, frameon=False, fontsize=8
    )
    caption = (
        "Each size fitted to each stretch that shows it, with all else as in the extension. A vertical bar "
        "is its 95 % interval. Where a bar does not meet the dashed line, one size throughout is wrong."
    )
    return Segment(_TITLE, png(drawn), caption, _where(shown[0], result))


def _draw(axes: Axes, series: SizeOverTime, result: Criticism) -> None:
    """Draw one size over time, and its means on either side of the moment at which it changes."""
    factor, unit = everyday(float(np.max(np.abs(series.sizes))), series.unit)
    of_part = np.array(series.flights)
    for k, flight in enumerate(dict.fromkeys(series.flights)):
        own = of_part == flight
        axes.errorbar(
            series.begin_s[own] + series.part_s / 2, factor * series.sizes[own],
            factor * WIDE * series.errors[own], linestyle="none", label=flight,
            color=_COLOURS[k % len(_COLOURS)], marker=_MARKERS[k // len(_COLOURS) % len(_MARKERS)],
            linewidth=0.7, markersize=2,
        )  # fmt: skip
    whole = factor * _in_extension(result, series)
    axes.axhline(whole, color=GREY, linestyle="--", linewidth=1, label="one size throughout")
    if (change := change_of_size(result, series.effect, series.parameter)) is not None:
        begin, end = float(series.begin_s.min()), float(series.begin_s.max()) + series.part_s
        axes.step(
            [begin, change.time_s, end], factor * np.array([change.before.value, *2 * [change.after.value]]),
            where="post", color=VERMILLION, linewidth=1.8, zorder=5,
            label=f"mean before and after {change.moment}",
        )  # fmt: skip
    title = f"{title_of(series.effect)}: {quantity(series.effect, series.parameter)}"
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_ylabel(f"[{unit}]" if unit != "1" else "", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    grid(axes)


def _where(series: SizeOverTime, result: Criticism) -> str:
    """Return when a size changes, or where it is least and greatest."""
    of = series.effect, series.parameter
    words, change = quantity(*of), change_of_size(result, *of)
    least, most = (_part(series, int(k)) for k in (np.argmin(series.sizes), np.argmax(series.sizes)))
    if len(set(series.flights)) == 1:
        least = least.removesuffix(f" of {series.flights[0]}")
    sizes = f"{words} is {least} and {most}" if change is None else f"{words} changes at {change.moment}"
    like = "" if any(cause.name == series.effect for cause in result.causes) else "what looks like "
    line = f"{like}{series.effect} does not have one size: {sizes} (“{_TITLE}” shows each part)."
    return with_titles([line])[0]


def _possible(series: SizeOverTime) -> SizeOverTime:
    """Return the series without parts whose size no parameter can have: there the effect hardly acts, and the
    linear size is no size."""
    limits = CATALOGUE[series.effect].parameter(series.parameter)
    kept = (series.sizes >= limits.least) & (series.sizes <= limits.most)
    return replace(
        series, flights=tuple(np.array(series.flights)[kept].tolist()), begin_s=series.begin_s[kept],
        sizes=series.sizes[kept], errors=series.errors[kept],
    )  # fmt: skip


def _certainty(series: SizeOverTime) -> float:
    """Return the squared deviations of all parts from their weighted mean, in standard errors."""
    weight = series.errors**-2.0
    middle = np.average(series.sizes, weights=weight)
    return float(weight @ (series.sizes - middle) ** 2)


def _in_extension(result: Criticism, series: SizeOverTime) -> float:
    """Return the one size that the extended model has, or that fits all parts."""
    sizes = (c.parameters.get(series.parameter) for c in result.causes if c.name == series.effect)
    return next((size.value for size in sizes if size is not None), series.common)


def _part(series: SizeOverTime, k: int) -> str:
    factor, unit = everyday(float(series.sizes[k]), series.unit)
    begin = series.begin_s[k]
    size = f"{figure(factor * series.sizes[k])}{spaced(unit)}"
    return f"{size} from {begin:.0f} to {begin + series.part_s:.0f} s of {series.flights[k]}"
