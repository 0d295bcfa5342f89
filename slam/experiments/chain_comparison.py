"""The chain of pictures beside the paper's stitched map: the same, alike, or better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from slam.experiments.experiment import SeedStatistics

ALIKE = 2.0
"""Largest factor, up or down, between the paper's error and ours for which the two agree in part."""


@dataclass(frozen=True)
class ChainComparison:
    """Largest landmark error of the paper's map and of our chain of the same pictures, both in percent."""

    theirs_percent: float
    ours_percent: SeedStatistics

    @property
    def same(self) -> bool:
        """Whether the paper's error lies within the interval of ours over all seeds."""
        return self.ours_percent.lower95 <= self.theirs_percent <= self.ours_percent.upper95

    @property
    def factor(self) -> float:
        """How many times our error the paper's is."""
        return self.theirs_percent / self.ours_percent.median

    @property
    def alike(self) -> bool:
        """Whether the two differ by a factor of at most ``ALIKE``, up or down."""
        return 1 / ALIKE <= self.factor <= ALIKE

    def words(self, table: str) -> str:
        """Say how far the two differ, and why a much better map does not repeat the paper's."""
        if self.factor < 1:
            return f"ours is {1 / self.factor:.1f} times as large. "
        found = f"{self.factor:.1f} times ours. "
        if self.same:
            return found
        return (
            f"{found}Ours is a better map, not the paper's, so {table} is surpassed and not repeated. "
            "Possible causes are the pictures of the paper's game engine and its features (SURF), which we "
            "do not have. "
        )
