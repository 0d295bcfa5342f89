"""Findings that compare flights with a model: what no cause explains, with one class for each kind."""

from __future__ import annotations

from dataclasses import dataclass

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
class Onset(Finding):
    """A parameter of a term, or an error of a channel, that changes at a moment of a flight."""

    time_s: float
    change: float
    unit: str

    def _text(self) -> str:
        what = self.column if self.effect else f"an error of {self.channel}"
        return f"{what} changes by {self.change:.2g}{spaced(self.unit)} at about {self.time_s:.0f} s"
