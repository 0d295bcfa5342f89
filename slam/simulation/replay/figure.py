"""A picture of a replay: each channel measured and simulated, and the braking after the longest push."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import BLUE, GREY, ORANGE, PALE_GREY, VERMILLION, escape_math, png
from slam.simulation.replay.channels import display_unit
from slam.simulation.replay.compare import Comparison, Replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
PANEL_IN = (4.6, 2.2)
"""Size of a panel: three of them fill a laptop's screen at 100 %, and one is not lost on it."""
MOST_POINTS = 3000
"""Largest number of points drawn per stream, more than there are pixels."""
BEFORE_S, AFTER_S = 1.0, 4.0
"""Time shown before a push of the stick and after its release: the vehicle has stopped by then."""
LEAST_SPEED_STD_M_S = 0.02
"""A speed that varies less than this shows no braking."""


def draw(replay: Replay) -> bytes:
    """Return the picture as PNG: measurements, the roll-out over the whole flight and the short ones."""
    return png(figure(replay))


def figure(replay: Replay) -> Figure:
    """Return the figure: the braking after the longest push where a speed was measured, then each channel."""
    from matplotlib.figure import Figure

    shown = [channel for channel in replay.channels if np.isfinite(channel.measured).any()]
    braking = _braking_channel(replay)
    columns = max(1, min(COLUMNS, len(shown)))
    rows = -(-len(shown) // columns)
    width = max(PANEL_IN[0] * columns, 7.0)
    drawn = Figure(
        figsize=(width, 1.1 + PANEL_IN[1] * rows + (3.0 if braking else 0.0)), dpi=110, layout="constrained"
    )
    heights = [1.35] * bool(braking) + [1.0] * rows
    grid = drawn.add_gridspec(len(heights), columns, height_ratios=heights)
    first = None
    for k, channel in enumerate(shown):
        row = k // columns + bool(braking)
        first = axes = drawn.add_subplot(grid[row, k % columns], sharex=first)
        _panel(axes, channel, replay)
        if k + columns >= len(shown):
            axes.set_xlabel("time [s]")
    if braking is not None:
        _braking(drawn.add_subplot(grid[0, :]), braking, replay)
    if first is not None:
        handles, labels = first.get_legend_handles_labels()
        drawn.legend(handles, labels, loc="outside lower center", ncols=2 if columns == 1 else 4)
    title = f"{replay.flight} and what model {replay.model} makes of its commands"
    drawn.suptitle(
        escape_math(f"{title}\nerrors: RMS over {replay.shown_s:g} s from each new start"), fontsize=11
    )
    return drawn


def _panel(axes: Axes, channel: Comparison, replay: Replay) -> None:
    factor, unit = display_unit(channel.unit)
    every = max(1, len(channel.stamps_s) // MOST_POINTS)
    t = channel.stamps_s[::every]
    _pushes(axes, replay)
    axes.plot(t, factor * channel.measured[::every], ".", color=GREY, ms=2, label="measured")
    short = factor * channel.restarted[::every]
    axes.plot(t, short, color=ORANGE, lw=1.2, label=f"simulated, started anew every {replay.shown_s:g} s")
    axes.plot(t, factor * channel.simulated[::every], color=BLUE, lw=1, label="simulated, whole flight")
    shown = f"{channel.name} [{unit}], off by {factor * channel.rms[replay.shown_s]:.3g}"
    axes.set_title(shown, fontsize=9, loc="left")
    axes.grid(alpha=0.3)


def _pushes(axes: Axes, replay: Replay) -> None:
    for k, (begin_s, end_s) in enumerate(replay.pushes_s):
        label = "stick asks for a tilt" if k == 0 else None
        axes.axvspan(begin_s, end_s, color=PALE_GREY, alpha=0.45, lw=0, label=label)


def _braking_channel(replay: Replay) -> Comparison | None:
    """Return the measured speed that varies most; None without a push or without a speed."""
    speeds = [c for c in replay.channels if c.name.startswith("velocity.") and np.isfinite(c.measured).any()]
    if not replay.pushes_s or not speeds:
        return None
    fastest = max(speeds, key=lambda channel: float(np.nanstd(channel.measured)))
    return fastest if np.nanstd(fastest.measured) >= LEAST_SPEED_STD_M_S else None


def _braking(axes: Axes, channel: Comparison, replay: Replay) -> None:
    """Enlarge the longest push that ends inside the flight, and the braking after it."""
    inside = [push for push in replay.pushes_s if push[1] + 1.0 <= replay.end_s] or list(replay.pushes_s)
    begin_s, end_s = max(inside, key=lambda push: push[1] - push[0])
    factor, unit = display_unit(channel.unit)
    now = (channel.stamps_s >= begin_s - BEFORE_S) & (channel.stamps_s <= end_s + AFTER_S)
    t = channel.stamps_s[now]
    axes.axvspan(begin_s, end_s, color=PALE_GREY, alpha=0.45, lw=0)
    axes.axvline(end_s, color=VERMILLION, lw=1.2, ls="--")
    axes.annotate(
        "stick released: braking begins", (end_s, 0.97), xycoords=("data", "axes fraction"),
        xytext=(6, 0), textcoords="offset points", va="top", fontsize=9, color=VERMILLION,
    )  # fmt: skip
    axes.plot(t, factor * channel.measured[now], ".", color=GREY, ms=4)
    axes.plot(t, factor * channel.restarted[now], color=ORANGE, lw=1.6)
    axes.plot(t, factor * channel.simulated[now], color=BLUE, lw=1.6)
    axes.set_xlim(begin_s - BEFORE_S, end_s + AFTER_S)
    axes.set_title(
        f"the longest push of the stick and the braking after it: {channel.name} [{unit}]",
        fontsize=9,
        loc="left",
    )
    axes.grid(alpha=0.3)
