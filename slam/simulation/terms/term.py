"""A term: one physical effect with its name, parameters, equation, correction, confounders and words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight

Array = NDArray[np.float64]

Family = Literal["motion", "camera", "sonar", "imu", "timing", "place"]
ActsOn = Literal["command", "force", "wind", "sensor", "image", "clock", "place"]
Stream = Literal["", "imu", "velocity", "sonar", "camera", "frames"]

BODY_AXES = {"x": "axis ahead, x", "y": "axis to the left, y", "z": "axis up, z"}
WORLD_AXES = {"x": "along x of the world", "y": "along y of the world"}
"""Names of the quantities along an axis."""

Reading = Callable[[Any, Any, Any, Any, Any, int], None]
"""Equation of a term that changes the readings of an instrument, given what it reads without the term.

The arguments are ``(out, state, rate, elapsed, values, first)``. It changes ``out`` in place: the reading
(gyro and accelerometer (6,), velocity (2,), or range (1,)). ``state`` and ``rate`` are the state of the
equations of motion (`slam.simulation.state`) and its derivative, with the height above what lies below as
entry Z. ``elapsed`` is the share of the flight that is over. The term's parameters are ``values[first]`` and
the entries behind it. The simulator calls it with arrays (entries, n) of n readings, and the filter
compiles it for single ones: it holds numpy functions and plain arithmetic, and no branch on a state.
"""
Undo = Callable[[Flight, Array, "float | None"], Flight]
"""Correction of a recording: flight, the term's parameters (n,), and their largest standard deviation if it
is known. Returns the flight as it would have been recorded without the term."""


FAST_TILTS = "pulses of 0.2 s at half stick, there and back three times, 1 s apart, ahead and to the side"
"""Manoeuvre for terms that show by fast tilts, as in ``slam.simulation.healthy.manoeuvres``."""


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
    step: float = 0.0
    """Step of the difference for its derivative (of a square: of the square); 0: it has no plain one."""
    squared: bool = False
    """Whether criticism fits its square: its sign cannot be observed, or the effect grows with the square."""
    alone: bool = False
    """Whether criticism tries it without the term's other parameters."""
    quantity: str = ""
    """Plain name of the quantity, beside the title of the term."""

    @property
    def is_limit(self) -> bool:
        """Whether it bounds a quantity: it acts where it is small enough, and has no slope at its neutral
        value."""
        return self.neutral == self.most


@dataclass(frozen=True)
class Term:
    """An effect of a model: the simulator simulates it, criticism selects and fits it."""

    name: str
    title: str
    """Plain name for a pilot: a noun, with its article where it needs one."""
    meaning: str
    """Meaning in a pilot's words, as a part of a sentence behind the name."""
    family: Family
    acts_on: ActsOn
    parameters: tuple[Parameter, ...]
    equation: str
    """Equation of the term, in the symbols of the documentation."""
    instrument: str = ""
    """Plain name of the instrument that has the error; empty for an effect of the vehicle or the place."""
    confounders: tuple[str, ...] = ()
    """Names of terms with a similar effect on a flight."""
    looks_alike: str = ""
    """Sentence about an error of another instrument that looks the same, and what tells them apart: an error
    that no term of the catalogue has."""
    excitation: str = ""
    """Manoeuvre that distinguishes the term from its confounders, and remarks, behind a semicolon."""
    stream: Stream = ""
    """Stream of a flight that the term changes, if it is one of an instrument."""
    read: Reading | None = None
    """Equation in the instrument's reading; None where the term acts elsewhere."""
    undo: Undo | None = None
    """Correction of a recording; None where nothing can be undone: the effect is a loss, or random."""
    in_differences: bool = False
    """Whether differences of readings over half a second show it, so that instruments can be compared with
    each other for it. They do not show a constant offset, and hardly a slow drift."""
    scales: bool = False
    """Whether the term multiplies the whole reading."""
    tolerance: float = 0.0
    """Size below which a comparison of instruments does not tell it from none: what integrals over half a
    second leave in healthy flights, and the accuracy of features in pictures."""
    in_single_readings: bool = False
    """Whether it is detected in single readings or pictures, whatever the search does."""

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

    @property
    def manoeuvre(self) -> str:
        """The ``excitation`` without its remarks."""
        return self.excitation.partition(";")[0]

    @property
    def is_of_instrument(self) -> bool:
        """Whether the term belongs to the instruments, not to the vehicle or the place."""
        return self.acts_on in ("sensor", "image", "clock")

    @property
    def smooth(self) -> tuple[Parameter, ...]:
        """Parameters with a derivative by a plain difference."""
        return tuple(parameter for parameter in self.parameters if parameter.step)


def size(name: str, unit: str, low: float, high: float, most: float, **options: Any) -> Parameter:
    """Return a parameter that is neutral at 0 and never negative."""
    return Parameter(name=name, unit=unit, neutral=0.0, low=low, high=high, least=0.0, most=most, **options)


def signed(name: str, unit: str, reach: float, most: float, **options: Any) -> Parameter:
    """Return a parameter of either sign that is neutral at 0."""
    return Parameter(
        name=name, unit=unit, neutral=0.0, low=-reach, high=reach, least=-most, most=most, **options
    )
