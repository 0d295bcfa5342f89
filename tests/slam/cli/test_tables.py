"""The tables on the terminal."""

from __future__ import annotations

import io

from rich.console import Console

from slam.cli.tables import rich_table
from slam.report.tables.evaluation import FigureTable


def test_text_in_brackets_is_printed_without_markup():
    out = io.StringIO()
    table = FigureTable(
        "a [bold]flight[/]", ("picture", "x, y, z [m]", "turn [rad]"), (("[red]a[/]", "1", "2"),)
    )
    Console(file=out, width=120).print(rich_table(table))
    for text in ("a [bold]flight[/]", "x, y, z [m]", "turn [rad]", "[red]a[/]"):
        assert text in out.getvalue()
