"""What an experiment is, and what comes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRONE, SIMULATOR = "AR.Drone (paper)", "USARSim (paper)"
"""Columns of the paper's own figures: the real drone's, which nobody can fly again, and its simulator's."""
PAPER = "paper"
"""Column of what the paper says of neither."""


Verdict = Literal["agrees", "agrees in part", "does not agree", "nothing to compare with"]


@dataclass(frozen=True)
class SeedStatistics:
    """A figure over all seeds."""

    median: float
    lower95: float
    upper95: float
    """Between these lie 95 % of the seeds (2.5 % and 97.5 % quantiles)."""
    seeds: int
    """That gave a figure."""

    @staticmethod
    def of(values: Sequence[float]) -> SeedStatistics:
        """Of the values that are finite; NaN where none is."""
        known = np.array([value for value in values if np.isfinite(value)])
        if len(known) == 0:
            return SeedStatistics(np.nan, np.nan, np.nan, 0)
        low, middle, high = np.quantile(known, [0.025, 0.5, 0.975])
        return SeedStatistics(float(middle), float(low), float(high), len(known))


@dataclass(frozen=True)
class Trial:
    """One seed's run."""

    seed: int
    figures: dict[str, float]
    drawing: Any = None
    """What the picture needs of this run, where it was asked to be drawn."""


@dataclass(frozen=True)
class Row:
    """One quantity: the paper's figures beside ours."""

    name: str
    unit: str
    paper: dict[str, float] = field(default_factory=dict)
    """Column -> figure."""
    ours: dict[str, SeedStatistics] = field(default_factory=dict)
    """Column -> figure over the seeds."""


@dataclass(frozen=True)
class Conclusion:
    """What all trials come to; the first row is the one that the short table shows."""

    rows: tuple[Row, ...]
    verdict: Verdict
    reason: str
    """By which figures, and where it does not agree why."""

    @property
    def sentence(self) -> str:
        """Whether it agrees with the paper, and the reason."""
        return f"{self.verdict.capitalize()}: {self.reason}"


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper."""

    name: str
    title: str
    source: str
    """Where in the paper."""
    trial: Callable[[int, bool], Trial]
    """Fly one seed; the second argument asks for its drawing."""
    conclude: Callable[[tuple[Trial, ...]], Conclusion]
    draw: Callable[[Figure, tuple[Trial, ...]], None]
    size_inches: tuple[float, float] = (8.0, 6.0)
    random: bool = True
    """Whether seeds differ; one that is not random runs once."""


def column(trials: Sequence[Trial], key: str) -> list[float]:
    """A figure of all trials; NaN where one has none."""
    return [trial.figures.get(key, float("nan")) for trial in trials]


def over_seeds(trials: Sequence[Trial], key: str) -> SeedStatistics:
    """A figure over all trials."""
    return SeedStatistics.of(column(trials, key))


def verdict(agrees: bool, partly: bool = False) -> Verdict:
    """In words."""
    return "agrees" if agrees else "agrees in part" if partly else "does not agree"


def text(figure: SeedStatistics, unit: str = "", digits: int = 2) -> str:
    """A figure over all seeds in words: ``0.78 % (0.52 to 1.10 %)``."""
    unit = f" {unit}" if unit else ""
    low, high = f"{figure.lower95:.{digits}f}", f"{figure.upper95:.{digits}f}"
    return f"{figure.median:.{digits}f}{unit} ({low} to {high}{unit})"
