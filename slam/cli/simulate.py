"""``slam simulate``: a recipe flown on the spot, written as a flight folder with truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import FLIGHT_OUT, SEED

_RECIPE = typer.Argument(
    metavar="RECIPE",
    help="A recipe that comes with slam (figure_eight, square, hover, ...), or a .toml file.",
)
_MODEL = typer.Option(
    "--model", metavar="MODEL", help="In place of the recipe's: nominal, paper, or a .toml file."
)


def simulate(
    recipe: Annotated[str, _RECIPE],
    out: Annotated[Path, FLIGHT_OUT],
    seed: Annotated[int, SEED] = 0,
    model: Annotated[str | None, _MODEL] = None,
) -> None:
    """Simulate a flight with camera, sensors and truth.

    Two flights of one seed share their noise: give each a --seed of its own where they are judged together.
    """
    from slam.cli.console import console, show_progress
    from slam.cli.flights import show
    from slam.cli.tables import written
    from slam.io.flight_folder import write_flight
    from slam.simulation import load_recipe
    from slam.simulation import simulate as fly

    screen = console()
    with show_progress(screen) as progress:
        flight = fly(load_recipe(recipe, model), seed)
        write_flight(flight, out, progress)
    show(flight, screen)
    screen.print(written([out]), soft_wrap=True)
