"""Findings that compare flights with a model: what no cause explains, with one class for each kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from slam.core.units import spaced
from slam.data_quality.finding import Finding
from slam.simulation.terms import CATALOGUE

_ACTS_BY = " ~ "
"""Between the target and the signal in the name of a residual pattern."""


@dataclass(frozen=True)
class ResidualPattern(Finding):
    """Residuals of a channel, or forces, that are proportional to a signal."""

    name: str
    """One TARGET ~ SIGNAL, or two; pictures have patterns without a signal."""

    @staticmethod
    def of(name: str, z: float = 0.0) -> ResidualPattern:
        """Return the pattern of this name. The target is a channel, or a term that grows with time."""
        target = name.partition(_ACTS_BY)[0]
        if target in CATALOGUE:
            return ResidualPattern(name, effect=target, z=z)
        return ResidualPattern(name, channel=target, z=z)

    @property
    def proportions(self) -> list[tuple[str, str]]:
        """Each target with its signal; none where the pattern has no signal."""
        parts = (part.partition(_ACTS_BY) for part in self.name.split(", "))
        return [(target, signal) for target, _, signal in parts if signal]

    def _text(self) -> str:
        return self.name


@dataclass(frozen=True)
class Inconsistency(Finding):
    """A cause, or a term that looks like one, whose size is not the same in all parts of the flights."""

    between: str
    """Parts that disagree: ``from flight to flight``, ``during a flight`` or ``from channel to channel``."""
    excess: float
    """Excess of the chi-square of the parts' differences over its expectation."""
    is_cause: bool = True

    def _text(self) -> str:
        return f"{'' if self.is_cause else 'what looks like '}{self.effect} changes {self.between}"


@dataclass(frozen=True)
class NameInDoubt(Finding):
    """A cause, or a term that looks like one, in whose place other effects may be."""

    others: tuple[str, ...] = ()
    """Terms that may be in its place; none for what the catalogue does not hold."""
    is_cause: bool = True

    def _text(self) -> str:
        if not self.is_cause:
            return f"what looks like {self.effect} is something else"
        name = self.column if self.parameter else self.effect
        return f"{name} may be {' or '.join(self.others) or 'something else'}"


@dataclass(frozen=True)
class ImplausibleSize(Finding):
    """A term that would explain flights with a size that no usual instrument or vehicle has."""

    value: float
    unit: str

    def _text(self) -> str:
        return f"{self.column} would be {self.value:.2g}{spaced(self.unit)}, which is not plausible"


@dataclass(frozen=True)
class OutOfRange(Finding):
    """A constant of the vehicle (``channel``) that no healthy vehicle has, perhaps in place of ``effect``."""

    value: float | None = None
    unit: str = ""
    healthy: tuple[float, float] | None = None

    def _text(self) -> str:
        if self.value is None or self.healthy is None:
            return f"{self.channel} out of range"
        low, high = self.healthy
        instead = f"{self.effect} may be that " if self.effect else ""
        size = f"{self.value:.3g}{spaced(self.unit)} (healthy: {low:.3g} to {high:.3g})"
        return f"{instead}{self.channel} is {size}"


@dataclass(frozen=True)
class LateReadings(Finding):
    """Readings of a stream (``channel``) that come late, or early, by their stamps, or behind a filter."""

    BY_DELAY: ClassVar[str] = "late"
    BY_FILTER: ClassVar[str] = "smoothed"

    late_s: float
    """The mean age of a reading, or its standard deviation: of a low-pass filter, the time constant."""
    lag: str = BY_DELAY

    def _text(self) -> str:
        if self.lag == self.BY_FILTER:
            return f"{self.channel} smoothed over {1e3 * self.late_s:.1f} ms"
        return f"{self.channel} {'late' if self.late_s > 0.0 else 'early'} by {1e3 * abs(self.late_s):.1f} ms"


@dataclass(frozen=True)
class VaryingSize(Finding):
    """A parameter of a cause that varies between segments of the flights by half of itself."""

    least: float
    most: float
    unit: str
    segment_s: float
    like_attitude_deg: float = 0.0
    """Error of the attitude that would look the same; 0 where none would."""

    def _text(self) -> str:
        sizes = f"{self.least:.2g} to {self.most:.2g}{spaced(self.unit)} by segments of {self.segment_s:g} s"
        return f"{self.column} is {sizes}{self.like}"

    @property
    def like(self) -> str:
        """The attitude error that would look the same, as the end of a sentence."""
        off_deg = self.like_attitude_deg
        return f", like an attitude error of {off_deg:.0f} deg" if off_deg else ""


@dataclass(frozen=True)
class Onset(Finding):
    """A parameter of a term that changes at a moment of a flight."""

    time_s: float
    change: float
    unit: str

    def _text(self) -> str:
        return f"{self.column} changes by {self.change:.2g}{spaced(self.unit)} at about {self.time_s:.0f} s"
