"""Settings of the pipeline: a file's, then the command line's over them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.pipeline import PipelineConfig


def pipeline_config(path: Path | None, features: str | None) -> PipelineConfig:
    """Settings for ``slam.optimize``. Raises ``InputError`` where the file holds an unknown key."""
    from slam.config import load_config, read_toml
    from slam.pipeline import PipelineConfig

    config = PipelineConfig() if path is None else load_config(PipelineConfig, read_toml(path), str(path))
    return config if features is None else replace(config, features=features)
