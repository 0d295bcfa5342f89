"""A term that was found, with its sizes and what it gains: what search, residuals and verdict hand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.criticism.search.thresholds import MISFIT

Array = NDArray[np.float64]

SURE = 0.95
"""Probability of a cause that is told as certain."""
JUDGED_HORIZON_S = 2.0
NOT_AHEAD_S = 0.0
"""In place of a horizon where nothing is flown: from one picture to another."""
DRAWS = 4000


@dataclass(frozen=True)
class ChannelError:
    """Root mean square of one channel over the end of a horizon, before and after."""

    channel: str
    unit: str
    horizon_s: float
    before: float
    after: float


@dataclass(frozen=True)
class Interval:
    """A fitted number."""

    value: float
    unit: str
    low: float
    high: float
    """95 % interval."""


@dataclass(frozen=True)
class Gain:
    """What it gains to know, on held-out flights or stretches."""

    nats: float
    ci95: tuple[float, float]
    by: str | None
    """``flight`` or ``segment``: what was held out; None where each reading tells by itself and no size
    enters."""
    parts: tuple[float, ...]
    """Nats of each held-out part, or else of each flight."""
    channels: tuple[ChannelError, ...]
    """Open-loop roll-out errors before and after, by channel and horizon; and what pictures miss."""

    @property
    def foremost(self) -> ChannelError | None:
        """What gains most two seconds ahead, or from picture to picture; None where nothing does by more than
        a misfit, or no errors are told."""
        better = [c for c in self.judged if 0 < c.after < (1.0 - MISFIT) * c.before]
        return min(better, key=lambda c: c.after / c.before, default=None)

    @property
    def judged(self) -> tuple[ChannelError, ...]:
        """Errors two seconds ahead, and those of pictures."""
        return tuple(c for c in self.channels if c.horizon_s in (JUDGED_HORIZON_S, NOT_AHEAD_S))

    @property
    def flies_worse(self) -> bool:
        """Whether two seconds ahead some channel is missed by more than before, beyond a misfit, and none by
        less."""
        return self.foremost is None and any(c.after > (1.0 + MISFIT) * c.before for c in self.judged)


@dataclass(frozen=True)
class Cause:
    """A term that was found."""

    name: str
    probability: float
    parameters: dict[str, Interval]
    gain: Gain
    z: float
    """How far it stands out beside the other causes."""
    lead_nats: float
    """Of its evidence over the best other term in its place."""
    alternatives: tuple[str, ...] = ()
    """Itself, and terms whose evidence in its place lies within 4 nats."""
    rival: str = ""
    """The other term that is likeliest in its place; empty where there is none."""


def bootstrap_interval(nats: Array) -> tuple[float, float]:
    """95 % interval of a sum over parts, by drawing parts with replacement."""
    rng = np.random.default_rng(0)
    drawn = rng.choice(nats, size=(DRAWS, len(nats))).sum(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)
