"""How far a term or a shape must stand out: from simulated healthy flights, shipped with the package."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np

CHANCE = "what chance reaches once in a hundred healthy cases"


@dataclass(frozen=True)
class Thresholds:
    """Of z, at a false-alarm rate of 1 % for both together."""

    effects: float
    """For the greatest of all terms."""
    patterns: float
    """For the greatest of the dictionary."""
    second: float
    """For one more term beside one that was found."""
    pairs: float
    """For two terms together that hide each other."""
    meaning: str = CHANCE
    """In words."""

    def times(self, factor: float, why: str) -> Thresholds:
        """All of them higher, and ``why``."""
        return Thresholds(
            factor * self.effects, factor * self.patterns, factor * self.second, factor * self.pairs,
            f"{factor:g} times {self.meaning}, as {why}",
        )  # fmt: skip


def load_thresholds(pictures: bool = False) -> Thresholds:
    """The shipped ones, for flights without or with pictures."""
    text = resources.files("slam.criticism.search").joinpath("thresholds.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return Thresholds(
        float(table["effects"]),
        float(table["shapes_with_pictures" if pictures else "shapes"]),
        float(table["second"]),
        float(table["pairs_with_pictures" if pictures else "pairs"]),
    )


MISFIT = 0.05
"""No equation of the catalogue tells what a real effect does to a smaller share of it."""


def with_misfit(threshold: float, greatest: float) -> float:
    """What must be exceeded beside a cause that stands out by ``greatest``: what its own misfit makes
    included."""
    return float(np.hypot(threshold, MISFIT * greatest))
