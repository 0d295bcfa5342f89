"""A table of figures for a person, the same on the terminal and in a report."""

from __future__ import annotations

from dataclasses import dataclass

UNKNOWN = "–"


@dataclass(frozen=True)
class FigureTable:
    """A table for a person: names first, figures after."""

    title: str
    columns: tuple[str, ...]
    """Empty where the rows need no headings."""
    rows: tuple[tuple[str, ...], ...]
