"""``slam simulate``: simulate a recipe and write a flight folder with truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.options import FLIGHT_OUT, QUIET, SEED

_RECIPE = typer.Argument(
    metavar="RECIPE",
    help="A recipe that slam ships (figure_eight, square, hover, ...), or a .toml file.",
)
_MODEL = typer.Option(
    "--model", metavar="MODEL", help="Model to use instead of the recipe's: nominal, paper, or a .toml file."
)


def simulate(
    recipe: Annotated[str, _RECIPE],
    out: Annotated[Path, FLIGHT_OUT],
    seed: Annotated[int, SEED] = 0,
    model: Annotated[str | None, _MODEL] = None,
    quiet: Annotated[bool, QUIET] = False,
) -> None:
    """Simulate a flight with camera, sensors and truth.

    Two flights with the same seed have the same noise: give each its own --seed if they are used together.
    """
    from slam.cli.console import Screen
    from slam.cli.flights import show
    from slam.io.flight_folder import write_flight
    from slam.simulation import load_recipe
    from slam.simulation import simulate as fly

    screen = Screen(quiet)
    with screen.progress() as progress:
        flight = fly(load_recipe(recipe, model), seed)
        write_flight(flight, out, progress)
    show(flight, screen)
    screen.files([out])
