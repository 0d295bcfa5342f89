"""Numbers and coordinates in the cells of a table."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.messages import Message, warning
from slam.io.files import brief, refusal
from slam.io.recordings.tables.columns import Column
from slam.io.recordings.tables.layout import Layout

Array = NDArray[np.float64]

_MISSING = ("-", "nan", "null", "none", "na", "n/a")
"""Cells without a reading beside empty ones, in small letters."""
_WITH_POINT = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_WITH_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_LIKE_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
_COORDINATE = re.compile(r"([NSEW])?\s*([-+.,\d]+)\s*°?\s*([NSEW])?", re.IGNORECASE)
"""A number with the letter of its hemisphere before or behind it."""
_LETTERS = "NSEWnsew°"
"""Ends of a coordinate that is no bare number."""


def decimal_mark(path: Path, layout: Layout, columns: Iterable[Column]) -> str:
    """Return the decimal mark of a table, a point or a comma: that of most numbers of its columns.

    Raises ``InputError`` where commas may as well separate thousands.
    """
    cells = {each.k: cells_of(layout, each) for each in columns if each.quantity != "picture"}
    commas = [
        (cell, layout.lines[row])
        for column in cells.values()
        for row, cell in enumerate(column)
        if "," in cell and _WITH_COMMA.fullmatch(cell)
    ]
    if not commas:
        return "."
    points = sum(_WITH_POINT.fullmatch(cell) is not None for column in cells.values() for cell in column)
    if len(commas) <= points:
        return "."
    if layout.delimiter == "," and all(_LIKE_THOUSANDS.fullmatch(cell) for cell, _ in commas):
        cell, line = commas[0]
        what = f"has {cell!r}: its comma is a decimal mark, or separates thousands"
        raise refusal(path, what, "write decimal points, and no separators of thousands", line)
    return ","


def cells_of(layout: Layout, column: Column) -> list[str]:
    """Return the cells (n) of a column, empty where a row ends before it."""
    return [row[column.k].strip() if column.k < len(row) else "" for row in layout.rows]


def numbers(layout: Layout, column: Column, mark: str) -> tuple[Array, tuple[Message, ...]]:
    """Return a column (n,) in the units of the flight format, NaN where missing; and a line about its faults.

    ``mark`` is the decimal mark.
    """
    parse = _PARSERS.get(column.quantity, _number)
    values = np.full(len(layout.rows), np.nan)
    faults = []
    for row, cell in enumerate(cells_of(layout, column)):
        if not cell:
            continue
        try:
            values[row] = parse(cell, mark)
        except ValueError:
            if cell.lower() not in _MISSING:
                faults.append((cell, layout.lines[row]))
    return values * column.factor, _fault_note(column, faults, len(values))


def text_of(layout: Layout, column: Column) -> list[str]:
    """Return the cells (n) of a column of names, with slashes between folders."""
    return [cell.replace("\\", "/") for cell in cells_of(layout, column)]


def _fault_note(column: Column, faults: Sequence[tuple[str, int]], count: int) -> tuple[Message, ...]:
    if not faults:
        return ()
    cell, line = faults[0]
    is_marked = "," in cell
    do = "write decimal points and no other marks" if is_marked else "leave cells without a reading empty"
    return (
        warning(
            f"column {brief(column.title, 40)!r}: {len(faults)} of {count} cells are no numbers, first "
            f"{brief(cell, 40)!r} in line {line}",
            do,
        ),
    )


def _number(cell: str, mark: str) -> float:
    """Return the number of a cell. Raises ``ValueError``."""
    if "_" in cell or (mark == "," and "." in cell):
        raise ValueError(cell)
    return float(cell if mark == "." else cell.replace(mark, "."))


def _coordinate(cell: str, mark: str) -> float:
    """Return the number of a cell, negative in the south and in the west. Raises ``ValueError``."""
    found = _COORDINATE.fullmatch(cell) if cell[-1:] in _LETTERS or cell[:1] in _LETTERS else None
    if found is None:
        return _number(cell, mark)
    letter = (found[1] or found[3] or "N").upper()
    value = _number(found[2], mark)
    return -value if letter in "SW" else value


def _truth(cell: str, mark: str) -> float:
    """Return 1 for true and 0 for false, words or numbers. Raises ``ValueError``."""
    word = cell.lower()
    return float(word == "true") if word in ("true", "false") else _number(cell, mark)


_PARSERS = {"latitude": _coordinate, "longitude": _coordinate, "is_video": _truth}
"""Quantity -> how its cells are read, other than as numbers."""
