"""What a term is: one physical effect with a name, parameters, its equation, and what it is mistaken for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Family = Literal["motion", "camera", "sonar", "imu", "timing", "place"]
ActsOn = Literal["command", "force", "wind", "sensor", "image", "clock", "place"]


@dataclass(frozen=True)
class Parameter:
    """One number of a term."""

    name: str
    unit: str
    """SI: m, s, rad, 1 (a share or factor), and what is made of them; ppm for clocks."""
    neutral: float
    """The value at which the term is not there."""
    low: float
    high: float
    """What one would call a normal size, beside ``neutral``. A hidden effect may be smaller."""
    least: float
    most: float
    """What the equation bears: a model with a value beyond is refused."""
    slot: str = ""
    """Entry of the equations' parameter vector it sets; by default ``TERM.NAME``."""


@dataclass(frozen=True)
class Term:
    """An effect that a model can hold: the simulator runs it, criticism switches, perturbs and fits it."""

    name: str
    family: Family
    acts_on: ActsOn
    parameters: tuple[Parameter, ...]
    equation: str
    """Where and how it acts, in the symbols of the docs."""
    confounders: tuple[str, ...] = ()
    """Names of the terms whose trace in a flight looks alike."""
    excitation: str = ""
    """What to fly to tell it from them."""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name. Raises ``KeyError``."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def neutral(self) -> dict[str, float]:
        """Values at which the term is not there."""
        return {parameter.name: parameter.neutral for parameter in self.parameters}


def size(name: str, unit: str, low: float, high: float, most: float) -> Parameter:
    """A parameter that is 0 where the term is not there, and never negative."""
    return Parameter(name, unit, 0.0, low, high, 0.0, most)


def signed(name: str, unit: str, reach: float, most: float) -> Parameter:
    """A parameter of either sign, 0 where the term is not there."""
    return Parameter(name, unit, 0.0, -reach, reach, -most, most)
