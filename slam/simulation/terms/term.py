"""A term: one physical effect with a name, parameters, an equation and confounders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Family = Literal["motion", "camera", "sonar", "imu", "timing", "place"]
ActsOn = Literal["command", "force", "wind", "sensor", "image", "clock", "place"]


@dataclass(frozen=True)
class Parameter:
    """One parameter of a term."""

    name: str
    unit: str
    """SI unit: m, s, rad, 1 (a share or factor) and their combinations; ppm for clocks."""
    neutral: float
    """Value at which the term has no effect."""
    low: float
    high: float
    """Usual range is ``low`` to ``high``. A hidden effect may be smaller."""
    least: float
    most: float
    """Valid range is ``least`` to ``most``; a model with a value outside is an error."""
    slot: str = ""
    """Entry of the parameter vector of the equations that it sets; by default ``TERM.NAME``."""


@dataclass(frozen=True)
class Term:
    """An effect of a model: the simulator simulates it, criticism selects and fits it."""

    name: str
    family: Family
    acts_on: ActsOn
    parameters: tuple[Parameter, ...]
    equation: str
    """Equation of the term, in the symbols of the documentation."""
    confounders: tuple[str, ...] = ()
    """Names of terms with a similar effect on a flight."""
    excitation: str = ""
    """Manoeuvre that distinguishes the term from its confounders."""

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of that name. Raises ``KeyError``."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def neutral(self) -> dict[str, float]:
        """Values at which the term has no effect."""
        return {parameter.name: parameter.neutral for parameter in self.parameters}


def size(name: str, unit: str, low: float, high: float, most: float) -> Parameter:
    """Return a parameter that is neutral at 0 and never negative."""
    return Parameter(name=name, unit=unit, neutral=0.0, low=low, high=high, least=0.0, most=most)


def signed(name: str, unit: str, reach: float, most: float) -> Parameter:
    """Return a parameter of either sign that is neutral at 0."""
    return Parameter(name=name, unit=unit, neutral=0.0, low=-reach, high=reach, least=-most, most=most)
