"""``slam import`` and ``slam info``: recordings of others made into flights, and a look at what is in one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import FLIGHT_OUT

if TYPE_CHECKING:
    from rich.console import Console

    from slam.core.flight import Flight

_IMPORTED = typer.Argument(
    metavar="SOURCE", help="A folder of geotagged photos, or a EuRoC recording.", show_default=False
)
_SHOWN = typer.Argument(
    metavar="FLIGHT",
    help="A flight folder, a EuRoC recording, a folder of photos, or a .g2o pose graph.",
    show_default=False,
)


def import_flight(source: Annotated[Path, _IMPORTED], out: Annotated[Path, FLIGHT_OUT]) -> None:
    """Make a flight folder from photos or from a EuRoC recording; pictures keep their names."""
    from slam.cli.console import console, show_progress
    from slam.cli.source import import_source
    from slam.cli.tables import written
    from slam.io.flight_folder import write_flight

    screen = console()
    with show_progress(screen) as progress:
        flight = import_source(source, progress)
        write_flight(flight, out, progress)
    show(flight, screen)
    screen.print(written([out]), soft_wrap=True)


def info(source: Annotated[Path, _SHOWN]) -> None:
    """Show what a flight holds: sensors, rates, gaps, what is missing and what is odd."""
    from slam.cli.console import console
    from slam.cli.source import kind_of, open_flight
    from slam.core.progress import silent

    screen = console()
    if kind_of(source) == "graph":
        from slam.cli.graph import graph_figures
        from slam.cli.tables import shown

        screen.print(shown(graph_figures(source)))
        return
    flight, _ = open_flight(source, silent)
    show(flight, screen)


def show(flight: Flight, screen: Console) -> None:
    """Print what a flight holds."""
    from slam.cli.flight_tables import print_info
    from slam.core.flight_info import describe

    print_info(describe(flight), screen)
