"""Findings: what is odd about flights, with one class for each kind.

As a string, a finding is a part of a sentence: the text that verdict.json has.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from slam.core.units import spaced


@dataclass(frozen=True, kw_only=True)
class Finding(ABC):
    """Something odd about flights."""

    flight: str = ""
    """Flight in which it is; empty where it is in all of them, or where there is but one."""
    channel: str = ""
    """Channel, stream, instrument or constant of the vehicle that it concerns; empty for none."""
    effect: str = ""
    """Term of the catalogue that it concerns; empty for none."""
    parameter: str = ""
    """Parameter of the term; empty for none."""
    z: float = 0.0
    """Standard deviations by which it stands out; 0 where it has no such measure."""

    def __str__(self) -> str:
        return f"{self.label}{self._text()}{f' (z = {self.z:.1f})' if self.z else ''}"

    @abstractmethod
    def _text(self) -> str:
        """Return the text without the flight and the significance."""

    @property
    def label(self) -> str:
        """The flight that its text begins with; empty for none."""
        return f"{self.flight}: " if self.flight else ""

    @property
    def is_shown_otherwise(self) -> bool:
        """Whether flights with commands show it as a cause, or in the innovations of their filter, too."""
        return False

    @property
    def column(self) -> str:
        """TERM.PARAMETER that it concerns."""
        return f"{self.effect}.{self.parameter}"


@dataclass(frozen=True)
class Remark(Finding):
    """A finding that only its text tells."""

    text: str

    def _text(self) -> str:
        return self.text


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


def flights_to_name(names: Sequence[str]) -> list[str]:
    """Return what each flight of some names is called in its findings: nothing where there is but one."""
    return list(names) if len(names) > 1 else [""] * len(names)
