"""Causes, with their sizes and gains: the type that search, residuals and verdict exchange."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.core.arrays import Array
from slam.criticism.search.thresholds import MISFIT

SURE = 0.95
"""Probability from which a cause is reported as certain."""
LIKELY = 0.5
"""Probability above which a cause is more probable than not."""
FAINT = 0.05
"""Probability below which a cause, with its alternatives, is reported as left over."""
FAIR_SHARE = 0.9
"""Share of the cause's evidence by which a rival may lag: one that lags by more explains none of it."""
JUDGED_HORIZON_S = 2.0
NOT_AHEAD_S = 0.0
"""Horizon of errors that no roll-out makes: those from one picture to another."""
DRAWS = 4000
WIDE = 1.96
"""Half of a 95 % interval, in standard deviations."""


@dataclass(frozen=True)
class ChannelError:
    """Root mean square error of one channel over the end of a horizon, before and after a cause."""

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
    """Gain in prediction by a cause, on held-out flights or segments."""

    nats: float
    ci95: tuple[float, float]
    by: str | None
    """Held-out unit, ``flight`` or ``segment``; None where single readings show the cause."""
    parts: tuple[float, ...]
    """Nats of each held-out part, or else of each flight."""
    channels: tuple[ChannelError, ...]
    """Errors of roll-outs before and after, by channel and horizon, and reprojection errors."""

    @staticmethod
    def of(parts: Array, by: str | None, channels: tuple[ChannelError, ...] = ()) -> Gain:
        """Return the gain with these nats (n,) of each part, and the bootstrap interval of their sum."""
        drawn = np.random.default_rng(0).choice(parts, size=(DRAWS, len(parts))).sum(axis=1)
        low, high = np.quantile(drawn, [0.025, 0.975]).tolist()
        return Gain(float(parts.sum()), (low, high), by, tuple(parts.tolist()), channels)

    @property
    def beside_best(self) -> float:
        """Nats without the part that gains most."""
        return self.nats - max(self.parts)

    @property
    def foremost(self) -> ChannelError | None:
        """The channel with the greatest relative gain two seconds ahead, or from picture to picture; else at
        another horizon. It is None where no error falls by more than ``MISFIT``."""
        better = [c for c in self.channels if 0 < c.after < (1.0 - MISFIT) * c.before]
        return min(better, key=lambda c: (c not in self.judged, c.after / c.before), default=None)

    @property
    def judged(self) -> tuple[ChannelError, ...]:
        """Errors two seconds ahead, and reprojection errors."""
        return tuple(c for c in self.channels if c.horizon_s in (JUDGED_HORIZON_S, NOT_AHEAD_S))

    @property
    def flies_worse(self) -> bool:
        """Whether an error two seconds ahead grows by more than ``MISFIT`` and none falls by as much."""
        return self.foremost not in self.judged and any(
            c.after > (1.0 + MISFIT) * c.before for c in self.judged
        )


@dataclass(frozen=True)
class Cause:
    """A term of the catalogue that explains the flights."""

    name: str
    probability: float
    parameters: dict[str, Interval]
    gain: Gain
    z: float
    """Normal deviate of its score test beside the other causes."""
    lead_nats: float
    """Lead in evidence over the best other term in its place."""
    alternatives: tuple[str, ...] = ()
    """Its own name, then terms whose evidence in its place lies within 4 nats."""
    rival: str = ""
    """The most probable other term in its place; empty where there is none."""

    @property
    def fair_rival(self) -> str:
        """The rival; empty where it explains no fair part of what the cause does."""
        return self.rival if 0.0 < self.lead_nats < FAIR_SHARE * 0.5 * self.z**2 else ""

    def with_alternatives(self, probability: Mapping[str, float]) -> float:
        """Return its probability and that of its alternatives together."""
        others = sum(probability.get(n, 0.0) for n in self.alternatives[1:])
        return min(self.probability + others, 1.0)
