"""Figures of a criticism except its segments, with their captions: covariate, ranking, calibration, and gain
by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slam.core.plot_style import BLUE, GREEN, GREY, ORANGE, VERMILLION, new_figure, png
from slam.core.units import everyday
from slam.report.criticism.certainty import doubt_of_name, likeness_of_rival, longer_bar
from slam.report.criticism.plain_names import reading, title_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam.criticism.cause import Gain
    from slam.criticism.verdict.criticism import ChannelCheck, Criticism, Rank
    from slam.criticism.verdict.rollouts import ChannelResiduals, Covariate

Array = NDArray[np.float64]

MOST_BARS = 12
RIVALS = 3
"""Number of causes that are shown for comparison though they are improbable: those that stand out most."""
SHOWN_PROBABILITY = 0.005
"""Least probability of a bar: below it two digits show 0.00."""
CHECKS_A_ROW = 6
COVARIATE_BINS, FEWEST_IN_BIN = 12, 3
MOST_DOTS = 1500
SHOWN_SHARE = 0.005
"""Share of the values at either end that the axes exclude: one outlier would compress all others."""


def covariate_picture(found: Covariate) -> bytes:
    """Draw the residuals against the covariate of the leading cause, and against that of its rival.

    One panel has the width of both.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 2.9), dpi=160, layout="constrained")
    drawn = panels_of(found)
    for axes, misses in zip(np.ravel(figure.subplots(1, len(drawn))), drawn, strict=True):
        _draw_misses(axes, misses, found)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return png(figure)


def fair_covariate(result: Criticism) -> Covariate | None:
    """Return the covariate without its rival where that explains no fair part: the table of certainty says
    so, and a panel for it would say otherwise."""
    found = result.covariate
    lead = next((c for c in result.causes if found is not None and c.name == found.cause), None)
    if found is None or lead is None or lead.fair_rival == found.rival:
        return found
    return replace(found, against=tuple(m for m in found.against if m.cause == found.cause))


def panels_of(found: Covariate) -> list[ChannelResiduals]:
    """Return what is drawn: the leading cause, and its rival where its errors have a slope."""
    return [m for m in found.against if m.cause == found.cause or len(_bins_of(m.explained)[1]) > 1]


def _bins_of(x: Array) -> tuple[NDArray[np.int64], list[int]]:
    """Return the bin of each value, and the bins that hold enough of them for a mean."""
    low, high = np.quantile(x, [SHOWN_SHARE, 1.0 - SHOWN_SHARE])
    edges = np.linspace(low, high, COVARIATE_BINS + 1)
    bins = np.digitize(x, edges)
    return bins, [k for k in range(1, len(edges)) if np.sum(bins == k) >= FEWEST_IN_BIN]


def _draw_misses(axes: Axes, misses: ChannelResiduals, found: Covariate) -> None:
    factor, unit = everyday(1.0, misses.unit)
    x, plain = factor * misses.explained, factor * misses.residuals[""]
    some = np.unique(np.linspace(0, len(x) - 1, MOST_DOTS).astype(np.int64))
    axes.plot(x[some], plain[some], ".", color=GREY, markersize=3, alpha=0.5, label="single errors")
    low, high = np.quantile(x, [SHOWN_SHARE, 1.0 - SHOWN_SHARE])
    bins, full = _bins_of(x)
    middle = [float(np.mean(x[bins == k])) for k in full]
    shown = [low, high, *np.quantile(plain, [SHOWN_SHARE, 1.0 - SHOWN_SHARE])]
    # The line without either is wide, to be seen below another that is the same.
    two = len(panels_of(found)) > 1
    ways = (
        ("", "without either" if two else "without it", VERMILLION, 3.4),
        (found.cause, f"with {title_of(found.cause)}", BLUE, 1.4),
        (found.rival, f"with {title_of(found.rival)} instead", ORANGE, 1.4),
    )
    for name, label, colour, width in ways:
        if name == found.rival and not two:
            continue
        if name in misses.residuals and (name or colour == VERMILLION):
            means = [factor * float(np.mean(misses.residuals[name][bins == k])) for k in full]
            shown += means
            axes.plot(middle, means, "o-", color=colour, markersize=2 + width, linewidth=width, label=label)
    axes.plot(
        [low, high], [low, high], "--", color="black", linewidth=1, zorder=5, label="all of it explained"
    )
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_ylim(min(shown), max(shown))
    axes.locator_params(axis="x", nbins=4)
    axes.set_title(title_of(misses.cause), fontsize=9)
    axes.set_xlabel(f"predicted error [{unit}]", fontsize=9)
    axes.set_ylabel(f"{reading(misses.channel)}: missed [{unit}]", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)


def covariate_caption(result: Criticism) -> str:
    """Caption of the covariate's figure; empty where there is none."""
    found = result.covariate
    if found is None:
        return ""
    first = found.against[0]
    what = (
        "disagreement of the instruments, in its standard deviations"
        if first.unit == "sigma"
        else "error of the model's prediction over two seconds"
    )
    text = (
        f"Vertical axis: {what}. Horizontal axis: the error that the cause predicts. The means of single "
        "errors follow the dashed line as far as the cause explains the error; those with it "
        "should be flat, and a slope of these is left unexplained."
    )
    if len(panels_of(found)) < 2:
        return text
    return f"{text} The other panel is the same for {title_of(found.rival)}, the most probable alternative."


_IN_WORDS = {"nothing": "nothing is wrong", "unknown": "something unknown"}
"""Hypotheses that are not terms of the model."""


def ranking_picture(result: Criticism) -> bytes:
    """Draw bars of probability and strength; ``nothing`` and ``unknown`` are always among them.

    The strength of a cause that was found is that beside the others, as the limit asks for.
    """
    always = [r for r in result.ranking if r.name in _IN_WORDS and not _is_untried(r, result)]
    chosen = {cause.name for cause in result.causes}
    others = (r for r in result.ranking if r.name not in _IN_WORDS and r.name not in chosen)
    rivals = sorted(others, key=lambda r: -r.z)[:RIVALS]
    # A probability that two names share is drawn at both.
    shared = {c.fair_rival: c.probability for c in result.causes if likeness_of_rival(c, result)}
    probability = {r.name: r.probability for r in result.ranking} | shared
    possible = [
        r
        for r in result.ranking
        if probability[r.name] >= SHOWN_PROBABILITY or r.name in chosen or r in rivals
    ]
    strength = {r.name: r.z for r in result.ranking} | {c.name: c.z for c in result.causes}
    single = {c.name for c in result.causes if c.gain.by is None}
    named = sorted(
        (r for r in possible if r.name not in _IN_WORDS),
        key=lambda r: (-probability[r.name], -strength[r.name]),
    )
    shown = (named[: MOST_BARS - len(always)] + always)[::-1]
    widths = [strength[r.name] for r in shown]
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(7.2, 0.8 + 0.28 * len(shown)), dpi=160, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = [_IN_WORDS.get(r.name, title_of(r.name)) for r in shown]
    colours = [BLUE if r.name in chosen else ORANGE if r in always else GREY for r in shown]
    open_ = {cause.name for cause in result.causes if doubt_of_name(cause, result)} | shared.keys()
    faces = ["none" if r.name in open_ else colour for r, colour in zip(shown, colours, strict=True)]
    left.barh(names, [probability[r.name] for r in shown], color=faces, edgecolor=colours)
    left.set_xlim(0, 1)
    left.set_xlabel("probability")
    right.barh(
        names, widths,
        color=[GREY if r.name in single else c for r, c in zip(shown, colours, strict=True)],
    )  # fmt: skip
    right.axvline(result.threshold, color=VERMILLION, linewidth=1, label=f"asked for: {result.threshold:.1f}")
    right.set_xlabel("stands out by [sigma]")
    kinds = ((BLUE, "beside the other causes"), (GREY, "alone")) if len(chosen) > 1 else ()
    handles = [*right.get_legend_handles_labels()[0], *(Patch(color=c, label=label) for c, label in kinds)]
    figure.legend(handles=handles, loc="outside lower right", ncols=3, frameon=False, fontsize=8)
    if max(widths, default=0.0) > 50:
        right.set_xscale("symlog", linthresh=5)
        right.set_xlabel("stands out by [sigma, log scale]")
        right.xaxis.set_major_formatter("{x:g}")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
    return png(figure)


def _is_untried(rank: Rank, result: Criticism) -> bool:
    """Return whether something unknown had no chance: without commands nothing predicts the motion, and only
    a delay is tried."""
    return bool(result.limits) and rank.name == "unknown" and rank.probability < SHOWN_PROBABILITY


def ranking_caption(result: Criticism) -> str:
    """Return the caption of the ranking, with its line, and with bars that are none of a name alone."""
    unknown = rest = ""
    if any(rank.name == "unknown" and not _is_untried(rank, result) for rank in result.ranking):
        unknown = ", and that more is wrong than the causes explain (something unknown)"
        rest = "; something unknown is no single effect, and has no bar"
    lines = [
        f"Left: probability of each cause given these flights, alone or in the best set{unknown}. Several "
        "may be there at once.",
        "Right: standard deviations by which it stands out, beside the other causes or alone in the original "
        f"model{rest}; the line ({result.threshold:.1f}) is {result.threshold_means}.",
        longer_bar(result),
    ]
    doubts = [
        f"{title_of(c.name)} and {title_of(c.fair_rival)} share theirs"
        if likeness_of_rival(c, result)
        else f"the size of {title_of(c.name)} may be none"
        for c in result.causes
        if doubt_of_name(c, result)
    ]
    if doubts:
        lines.append(f"Open bars are no probability of one name: {'; '.join(doubts)}.")
    return " ".join(filter(None, lines))


def calibration_picture(checks: Sequence[ChannelCheck]) -> bytes:
    """Draw for each channel how many innovations lie in each tenth of the predicted distribution."""
    from matplotlib.figure import Figure

    columns = min(len(checks), CHECKS_A_ROW)
    rows = -(-len(checks) // columns)
    figure = Figure(
        figsize=(max(1.2 * columns, 3.4), 0.4 + (1.3 if rows > 1 or columns > 2 else 2.0) * rows),
        dpi=160,
        layout="constrained",
    )
    all_axes = np.ravel(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False))
    for axes, check in zip(all_axes, checks, strict=False):
        tenths = np.array(check.tenths)
        axes.bar(np.arange(len(tenths)) + 0.5, len(tenths) * tenths, width=0.9, color=BLUE)
        axes.axhline(1.0, color=GREY, linewidth=0.8)
        axes.set_title(reading(check.channel), fontsize=9)
    figure.supxlabel("tenth of the predicted distribution", fontsize=8)
    figure.supylabel("share over expected", fontsize=8)
    most = max(len(check.tenths) * max(check.tenths) for check in checks)
    for axes in all_axes:
        axes.set_ylim(0.0, max(2.0, 1.05 * most))
        axes.tick_params(labelsize=8)
        axes.set_xticks([])
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_visible(bool(axes.patches))
    return png(figure)


def gain_picture(gain: Gain) -> bytes:
    """Draw one dot for each part that was held out, or for each flight."""
    figure, axes = new_figure(3.6, 2.6)
    number = np.arange(1, len(gain.parts) + 1)
    colour = [GREEN if nats > 0 else VERMILLION for nats in gain.parts]
    axes.axhline(0.0, color=GREY, linewidth=1)
    axes.scatter(number, gain.parts, c=colour, s=28, zorder=3)
    axes.set_xticks(number)
    axes.set_xlabel(f"held-out {'part' if gain.by == 'segment' else gain.by}" if gain.by else "flight")
    axes.set_ylabel("gain [nats]")
    return png(figure)
