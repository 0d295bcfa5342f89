"""Data types of an experiment, its trials and its conclusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRONE, SIMULATOR = "AR.Drone (paper)", "USARSim (paper)"
"""Columns of the paper's figures: those of the real drone, which cannot be repeated, and of its simulator."""
PAPER = "paper"
"""Column of the paper's figures that belong to neither."""


Verdict = Literal["agrees", "agrees in part", "does not agree", "nothing to compare with"]


@dataclass(frozen=True)
class SeedStatistics:
    """Median and 95 % interval of a figure over all seeds."""

    median: float
    lower95: float
    upper95: float
    """The 2.5 % and 97.5 % quantiles: 95 % of the seeds lie between them."""
    seeds: int
    """Number of seeds that gave a figure."""

    @staticmethod
    def of(values: Sequence[float]) -> SeedStatistics:
        """Compute the statistics of the finite values; NaN where there is none."""
        known = np.array([value for value in values if np.isfinite(value)])
        if len(known) == 0:
            return SeedStatistics(np.nan, np.nan, np.nan, 0)
        low, middle, high = np.quantile(known, [0.025, 0.5, 0.975])
        return SeedStatistics(float(middle), float(low), float(high), len(known))


@dataclass(frozen=True)
class Trial:
    """Result of one seed."""

    seed: int
    figures: dict[str, float]
    drawing: Any = None
    """Data for the figure, if it was requested."""


@dataclass(frozen=True)
class Row:
    """One quantity: the paper's figures and ours."""

    name: str
    unit: str
    paper: Mapping[str, float | SeedStatistics] = field(default_factory=dict)
    """Column -> figure, with its interval where the paper's own curves give one."""
    ours: dict[str, SeedStatistics] = field(default_factory=dict)
    """Column -> figure over the seeds."""


@dataclass(frozen=True)
class Conclusion:
    """Conclusion from all trials; the short table shows the first row."""

    rows: tuple[Row, ...]
    verdict: Verdict
    reason: str
    """Figures behind the verdict, and the cause of any disagreement."""

    @property
    def sentence(self) -> str:
        """The verdict and its reason."""
        return f"{self.verdict.capitalize()}: {self.reason}"


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper."""

    name: str
    title: str
    source: str
    """Section, tables and figures of the paper."""
    trial: Callable[[int, bool], Trial]
    """Fly one seed; the second argument asks for its drawing."""
    conclude: Callable[[tuple[Trial, ...]], Conclusion]
    draw: Callable[[Figure, tuple[Trial, ...]], None]
    size_inches: tuple[float, float] = (8.0, 6.0)
    random: bool = True
    """Whether seeds differ; an experiment that is not random runs once."""


def column(trials: Sequence[Trial], key: str) -> list[float]:
    """Return a figure of all trials; NaN where a trial has none."""
    return [trial.figures.get(key, float("nan")) for trial in trials]


def over_seeds(trials: Sequence[Trial], key: str) -> SeedStatistics:
    """Compute the statistics of a figure over all trials."""
    return SeedStatistics.of(column(trials, key))


def verdict(agrees: bool, partly: bool = False) -> Verdict:
    """Return the verdict in words."""
    return "agrees" if agrees else "agrees in part" if partly else "does not agree"


def text(figure: SeedStatistics, unit: str = "", digits: int = 2) -> str:
    """Format a figure over all seeds: ``0.78 % (0.52 to 1.10 %)``."""
    unit = f" {unit}" if unit else ""
    low, high = f"{figure.lower95:.{digits}f}", f"{figure.upper95:.{digits}f}"
    return f"{figure.median:.{digits}f}{unit} ({low} to {high}{unit})"
