"""The description of a flight that ``slam info`` and ``slam import`` print."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from slam.core.flight_info import FlightInfo
from slam.io.files import brief

NOTE_LENGTH = 300
"""Number of characters of a note that are printed; flight.yaml holds all of it."""


def print_info(info: FlightInfo, console: Console) -> None:
    """Print tables and lists; texts of the flight are printed as they are, never as markup."""
    title = f"{escape(brief(info.name))}, {info.duration_s:.1f} s"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    # Names of instruments are not broken on a terminal of 80 columns.
    table.add_column("stream", min_width=len("attitude0"), overflow="fold")
    for heading in (
        "rows",
        "rate [Hz]",
        "starts [s]",
        "lasts [s]",
        "gaps",
        "largest gap [s]",
        "values missing",
    ):
        table.add_column(Text(heading), justify="right")
    for s in info.streams:
        rate = "" if math.isnan(s.rate_hz) else f"{s.rate_hz:.3g}"
        cells = [str(s.count), rate, f"{s.start_s:.2f}", f"{s.duration_s:.2f}", str(s.gaps or "")]
        cells += [f"{s.largest_gap_s:.2f}" if s.gaps else "", str(s.missing_values or "")]
        table.add_row(s.name, *cells)
    console.print(table)
    for key, value in info.notes.items():
        shown = brief(value, NOTE_LENGTH)
        console.print(f"[bold]{escape(brief(key, 40))}[/bold]: {escape(shown)}", highlight=False)
    if info.landmarks:
        console.print(f"{info.landmarks} surveyed landmarks", highlight=False)
    for title, lines in (
        ("missing", info.missing),
        ("anomalies", info.anomalies),
        ("warnings", info.warnings),
    ):
        if lines:
            console.print(f"[bold]{title}[/bold]")
        for line in lines:
            console.print(f"  {escape(brief(line, 400))}", highlight=False)
