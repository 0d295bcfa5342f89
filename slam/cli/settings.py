"""Settings of the pipeline: a file's, then the command line's over them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from frontend.features import FeatureKind
    from slam.settings import PipelineConfig


def pipeline_config(path: Path | None, features: FeatureKind | None) -> PipelineConfig:
    """Settings for ``slam.optimize``. Raises ``InputError`` where the file holds an unknown key."""
    from slam.config import load_config, read_toml
    from slam.settings import PipelineConfig

    config = PipelineConfig() if path is None else load_config(PipelineConfig, read_toml(path), str(path))
    return config if features is None else replace(config, features=replace(config.features, kind=features))
