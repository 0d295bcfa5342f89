"""How far a term or a shape must stand out: from simulated healthy flights, shipped with the package."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True)
class Thresholds:
    """Of z, at a false-alarm rate of 1 % for both together."""

    effects: float
    """For the greatest of all terms."""
    shapes: float
    """For the greatest of the dictionary."""


def load_thresholds() -> Thresholds:
    """The shipped ones."""
    text = resources.files("slam.criticism").joinpath("thresholds.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return Thresholds(float(table["effects"]), float(table["shapes"]))
