"""The table that shows which channels of a recording were taken, and which were left."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from slam.core.errors import one_line
from slam.core.figure_table import FigureTable
from slam.core.names import listed
from slam.core.stream_source import NO_STREAM

if TYPE_CHECKING:
    from slam.cli.console import Screen
    from slam.core.flight import Flight

_MOST_CHANNELS = 12
"""Channels of a recording that were left and are listed; slam info --json lists all."""


def show_sources(flight: Flight, screen: Screen) -> None:
    """Print which channels of a recording were taken and which were left; nothing for a flight folder."""
    taken = [source for source in flight.sources if source.stream]
    left = [source for source in flight.sources if not source.stream]
    if not taken:
        return
    rows = tuple(
        (
            s.stream,
            s.channel,
            s.kind,
            str(s.rows),
            "" if math.isnan(s.rate_hz) else f"{s.rate_hz:.3g}",
            s.reading,
        )
        for s in taken
    )
    title = f"Taken from the recording of {flight.name}"
    screen.table(FigureTable(title, ("stream", "channel", "type", "rows", "rate [Hz]", "units, axes"), rows))
    rivals = [f"{s.channel} ({s.reading})" for s in left if s.reading != NO_STREAM]
    others = [s.channel for s in left if s.reading == NO_STREAM]
    for words, names in (("left", rivals), ("left, not read", others)):
        if names:
            screen.line(f"{words}: {listed([one_line(name) for name in names], _MOST_CHANNELS)}")
