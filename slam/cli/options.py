"""Options that several commands have."""

from __future__ import annotations

from typing import Literal

import typer

Features = Literal["sift", "orb", "orb-teblid", "akaze", "surf"]

OUT = typer.Option("--out", metavar="DIR", help="Where to write; an earlier output of slam is replaced.")
FLIGHT_OUT = typer.Option("--out", metavar="FLIGHT", help="The flight folder to write; must not exist yet.")
CONFIG = typer.Option(metavar="FILE.toml", help="Settings of the stages; an unknown key is refused.")
FEATURES = typer.Option(
    help="Feature detector and descriptor; default: what --config says, else sift.", show_default=False
)
MODEL = typer.Option(
    metavar="MODEL",
    help="What is known of the instruments, as extended.toml of slam criticise tells it: taken out of what "
    "they read before the map is made.",
)
SEED = typer.Option(min=0, help="Seed of all that is random.")
