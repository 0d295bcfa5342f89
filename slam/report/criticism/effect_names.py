"""Plain names of effects, and sizes in everyday units, in the text of a page."""

from __future__ import annotations

import re
from collections.abc import Sequence

from slam.core.units import everyday, spaced
from slam.simulation.terms import CATALOGUE

TWO_SIDED = 1.96
"""Standard deviations to either end of a 95 % interval."""
_MOST_IN_FIGURES = 999.5
"""Larger values with three significant figures would have an exponent."""
_NAMES = re.compile(rf"(?<![\w.(])({'|'.join(sorted(CATALOGUE, key=len, reverse=True))})(\.\w+)?(?![\w])")


def title_of(name: str) -> str:
    """Return the plain name of an effect without an article, or another name in words."""
    if name not in CATALOGUE:
        return name.replace("_", " ")
    return re.sub("^(a|an) ", "", CATALOGUE[name].title)


def with_titles(lines: Sequence[str]) -> list[str]:
    """Return lines with effects by their plain names; the code's name follows in brackets where one comes
    first."""
    seen: set[str] = set()

    def plain(found: re.Match[str]) -> str:
        title, code = CATALOGUE[found[1]].title, found[0]
        known = code in seen or code == title
        seen.add(code)
        return title if known else f"{title} ({code})"

    return [_NAMES.sub(plain, line) for line in lines]


def figure(value: float) -> str:
    """Return a value with three significant figures, and without an exponent where it is large."""
    return f"{value:.3g}" if abs(value) < _MOST_IN_FIGURES else f"{value:.0f}"


def sized_between(low: float, high: float, unit: str) -> str:
    """Return an interval with its everyday unit, which is that of the end farther from zero."""
    factor, name = everyday(max(low, high, key=abs), unit)
    return f"{figure(factor * low)} to {figure(factor * high)}{spaced(name)}"
