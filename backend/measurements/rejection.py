"""Why a link between two places was rejected: the check that it failed, and the figures of that."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

CONTRADICTED, UNPROVEN = "contradicted", "unproven"
"""Findings about a rejected link: other links contradict it, or it shows too little to tell."""
SAME_PLACE_HEIGHTS = 0.2
"""Heights of the camera by which a link may miss and still show the right place: a picture shows about one
height of ground to each side. The search for loops refuses none within it, unless its settings say so."""
_QUANTITY = re.compile(r"(\d[\d.]*(?:e[+-]\d+)?) (m|heights|sigma|deg)\b")
"""A quantity of the figures, as checks write it: its number and its unit."""
_MISFIT = re.compile(r"(\d[\d.]*(?:e[+-]\d+)?) (\w+), (\d[\d.]*(?:e[+-]\d+)?) deg$")


class LinkCheck(Enum):
    """A check that links have to pass; its value is why a link was rejected, in words of output files."""

    TOO_FEW_MATCHES = "too few matches"
    NO_PLANE = "no plane fits the matches"
    TOO_FEW_INLIERS = "too few inliers"
    OUTLIER_SHARE = "outlier share above gamma_1"
    OVERLAP = "folded or no overlap"
    SCALE = "implausible change of scale"
    CROWDED = "inliers crowded in one place"
    PRECISION = "homography poorly determined"
    REACH = "out of reach"
    PLACE = "implausible"
    CHAIN = "elsewhere than the pictures between"
    GRAPH = "disagrees"
    KNOWN_PLACE = "agrees, but too little is known of where it lies to trust it"
    INFORMATION = "carries no information"
    SOLVED_PART = "its part of the graph could not be solved"
    OTHER = ""

    @property
    def finding(self) -> str:
        """Whether a link that fails the check is contradicted or unproven."""
        return CONTRADICTED if self in _CONTRADICTIONS else UNPROVEN

    @property
    def joint(self) -> str:
        """Characters between the words and the figures."""
        return {LinkCheck.GRAPH: " by ", LinkCheck.OTHER: ""}.get(self, ": ")


_CONTRADICTIONS = (
    LinkCheck.OVERLAP,
    LinkCheck.SCALE,
    LinkCheck.REACH,
    LinkCheck.PLACE,
    LinkCheck.CHAIN,
    LinkCheck.GRAPH,
)


@dataclass(frozen=True)
class Misfit:
    """The difference between a link and the poses that the other links give its ends."""

    length: float
    unit: str
    """``m``, or ``heights`` of the camera before metres are known."""
    angle_deg: float

    def __str__(self) -> str:
        return f"{self.length:.2g} {self.unit}, {self.angle_deg:.2g} deg"


@dataclass(frozen=True)
class Rejection:
    """The check that a link failed."""

    check: LinkCheck
    figures: str = ""
    """Figures of the check in words; all words where the check is another one."""

    @classmethod
    def read(cls, text: str) -> Rejection:
        """Return the rejection that an output file holds as ``text``."""
        for check in LinkCheck:
            words, joint, figures = check.value, check.joint, text[len(check.value) :]
            if words and text.startswith(words) and (not figures or figures.startswith(joint)):
                return cls(check, figures.removeprefix(joint))
        return cls(LinkCheck.OTHER, text)

    @property
    def kind(self) -> str:
        """Words without figures, for counting."""
        return self.check.value or self.figures

    @property
    def misfit(self) -> Misfit | None:
        """The misfit that ends the figures of a link that disagrees; None for other checks."""
        found = _MISFIT.search(self.figures) if self.check is LinkCheck.GRAPH else None
        return Misfit(float(found[1]), found[2], float(found[3])) if found else None

    def figures_as_text(self, as_text: Callable[[str, str], str]) -> str:
        """Return the figures with each quantity with its number and unit by ``as_text``: m, ``heights`` of
        the camera before metres are known, ``sigma`` or ``deg``."""
        return _QUANTITY.sub(lambda found: as_text(found[1], found[2]), self.figures)

    def __str__(self) -> str:
        return f"{self.check.value}{self.check.joint if self.figures else ''}{self.figures}"
