"""Options that several commands have, and the settings that come of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from frontend.feature_kinds import FeatureKind
    from slam.mapping.config import PipelineConfig

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


def pipeline_config(path: Path | None, features: FeatureKind | None) -> PipelineConfig:
    """Settings of a file, those of the command line over them.

    Raises ``InputError`` where the file holds an unknown key.
    """
    from slam.core.toml_config import load_config, read_toml
    from slam.mapping.config import PipelineConfig

    config = PipelineConfig() if path is None else load_config(PipelineConfig, read_toml(path), str(path))
    return config if features is None else replace(config, features=replace(config.features, kind=features))
