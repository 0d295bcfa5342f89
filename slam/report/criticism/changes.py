"""Picture of a cause whose size is not the same throughout: its size in each part of each flight."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import BLUE, GREEN, GREY, ORANGE, VERMILLION, legend_below, new_figure, png
from slam.core.units import everyday, spaced
from slam.report.criticism.plain_names import TWO_SIDED, figure, quantity, title_of, with_titles
from slam.report.criticism.segment import Segment
from slam.simulation.terms import CATALOGUE

if TYPE_CHECKING:
    from slam.criticism import Criticism
    from slam.criticism.verdict.over_time import SizeOverTime

_TITLE = "When its size changes"
LINE_LETTERS, MARKER_LETTERS = 95, 6
"""Letters of the legend that the figure is wide, and those in whose width the marker and the gap stand."""
_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE)
_MARKERS = "osD^v"
"""With four colours they tell twenty flights apart; more of them share these."""


def size_over_time(result: Criticism) -> Segment | None:
    """Return the sizes over time of the parameter that changes most certainly; None where none changes."""
    from slam.criticism.verdict.over_time import PART_S

    told = [series for series in map(_possible, result.changes) if len(series.sizes) > 1]
    if not told:
        return None
    shown = max(told, key=_certainty)
    whole = _in_extension(result, shown)
    factor, unit = everyday(float(np.max(np.abs(shown.sizes))), shown.unit)
    drawn, axes = new_figure(7.2, 3.2)
    of_part = np.array(shown.flights)
    for k, flight in enumerate(dict.fromkeys(shown.flights)):
        own = of_part == flight
        axes.errorbar(
            shown.begin_s[own] + PART_S / 2, factor * shown.sizes[own],
            factor * TWO_SIDED * shown.errors[own], PART_S / 2, linestyle="none", label=flight,
            color=_COLOURS[k % len(_COLOURS)], marker=_MARKERS[k // len(_COLOURS) % len(_MARKERS)],
            linewidth=1.4, markersize=4,
        )  # fmt: skip
    axes.axhline(factor * whole, color=GREY, linestyle="--", linewidth=1, label="one size for all")
    name, _, parameter = shown.column.partition(".")
    axes.set_xlabel("time in the flight [s]")
    words = quantity(name, parameter)
    axes.set_ylabel(words + (f" [{unit}]" if unit != "1" else ""))
    longest = max(map(len, shown.flights)) + MARKER_LETTERS
    legend_below(axes, max(1, min(4, LINE_LETTERS // longest)))
    least, most = (_part(shown, int(k)) for k in (np.argmin(shown.sizes), np.argmax(shown.sizes)))
    caption = (
        f"{title_of(name)[0].upper()}{title_of(name)[1:]} ({words}), fitted to each {PART_S:g} s that show "
        "it, with all else as in the extension. A vertical bar is its 95 % interval, a horizontal one the "
        "time. Where a bar does not meet the dashed line, one size for all is wrong."
    )
    (where,) = with_titles(
        [f"{name} does not have one size: {words} is {least} and {most} (“{_TITLE}” shows each part)."]
    )
    return Segment(_TITLE, png(drawn), caption, where)


def _possible(series: SizeOverTime) -> SizeOverTime:
    """Return the series without parts whose size no parameter can have: there the effect hardly acts, and the
    linear size is no size."""
    name, _, parameter = series.column.partition(".")
    limits = CATALOGUE[name].parameter(parameter)
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
    name, _, parameter = series.column.partition(".")
    sizes = {p: found.value for c in result.causes if c.name == name for p, found in c.parameters.items()}
    return sizes.get(parameter, series.common)


def _part(series: SizeOverTime, k: int) -> str:
    from slam.criticism.verdict.over_time import PART_S

    factor, unit = everyday(float(series.sizes[k]), series.unit)
    begin = series.begin_s[k]
    size = f"{figure(factor * series.sizes[k])}{spaced(unit)}"
    return f"{size} from {begin:.0f} to {begin + PART_S:.0f} s of {series.flights[k]}"
