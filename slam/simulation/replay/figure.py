"""A picture of a replay: a panel per channel, measured and simulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slam.core.plot_style import BLUE, GREY, ORANGE, escape_math, png
from slam.simulation.replay.channels import display_unit
from slam.simulation.replay.compare import Comparison, Replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 3
MOST_POINTS = 3000
"""Largest number of points drawn per stream, more than there are pixels."""


def draw(replay: Replay) -> bytes:
    """Return the picture as PNG: measurements, the roll-out over the whole flight and the short ones."""
    return png(figure(replay))


def figure(replay: Replay) -> Figure:
    """Return the figure with one panel per channel."""
    from matplotlib.figure import Figure

    count = len(replay.channels)
    rows = -(-count // COLUMNS)
    drawn = Figure(figsize=(15, 1.0 + 1.6 * rows), dpi=110, layout="constrained")
    panels = np.atleast_1d(drawn.subplots(rows, COLUMNS, sharex=True, squeeze=False)).ravel()
    for axes, channel in zip(panels, replay.channels, strict=False):
        _panel(axes, channel, replay)
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[max(count - COLUMNS, 0) : count]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    handles, labels = panels[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside lower center", ncols=3)
    title = f"{replay.flight} and what model {replay.model} makes of its commands"
    drawn.suptitle(escape_math(f"{title}; off by: RMS over {replay.shown_s:g} s from each new beginning"))
    return drawn


def _panel(axes: Axes, channel: Comparison, replay: Replay) -> None:
    factor, unit = display_unit(channel.unit)
    every = max(1, len(channel.stamps_s) // MOST_POINTS)
    t = channel.stamps_s[::every]
    axes.plot(t, factor * channel.measured[::every], ".", color=GREY, ms=2, label="measured")
    short = factor * channel.restarted[::every]
    axes.plot(t, short, color=ORANGE, lw=1.2, label=f"simulated, begun again every {replay.shown_s:g} s")
    axes.plot(t, factor * channel.simulated[::every], color=BLUE, lw=1, label="simulated, whole flight")
    shown = f"{channel.name} [{unit}], off by {factor * channel.rms[replay.shown_s]:.3g}"
    axes.set_title(shown, fontsize=9, loc="left")
    axes.grid(alpha=0.3)
