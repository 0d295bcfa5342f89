"""A table of figures that the terminal and the report show alike."""

from __future__ import annotations

from dataclasses import dataclass

UNKNOWN = "–"


@dataclass(frozen=True)
class FigureTable:
    """A table for a reader: the first column holds names, the others figures."""

    title: str
    columns: tuple[str, ...]
    """Empty where the rows need no headings."""
    rows: tuple[tuple[str, ...], ...]
