"""The layout of a table's text: where its titles stand, and what separates its cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from slam.io.files import brief, refusal
from slam.io.recordings.tables.columns import TIMES, is_unit, known_names, quantities_of

_DELIMITERS = ",;\t|"
_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)
"""First line in which spreadsheets state the delimiter."""


@dataclass(frozen=True)
class Layout:
    """The cells of a table."""

    delimiter: str
    """One character; a blank stands for any number of them."""
    titles: tuple[str, ...]
    line: int
    """Line of the titles, from 1."""
    units: tuple[str, ...]
    """Units of a row of their own below the titles; else nothing."""
    rows: list[list[str]]
    lines: list[int]
    """Line of each row."""


def layout_of(path: Path, text: str, needed: Collection[str] = TIMES) -> Layout:
    """Return the cells of a table. Raises ``InputError`` where no line above the numbers names its key.

    ``needed`` are the quantities one of which is the key of a row: times, or pictures.
    """
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    stated = _SEPARATOR.fullmatch(lines[0][1].strip(" \r\n")) if lines else None
    lines = lines[1:] if stated else lines
    titled = _titles(lines, stated[1] if stated else "", needed)
    if titled is None:
        first = brief(lines[0][1], 80) if lines else ""
        key, title = ("a time", "time [s]") if needed == TIMES else ("pictures", "filename")
        what = f"is a table of readings without {key} (its first line: {first!r})"
        raise refusal(path, what, f"name a column {title}; columns that are read: {known_names()}")
    at, delimiter, titles = titled
    body = [(k, line) for k, line in lines[at + 1 :] if not line.lstrip().startswith("#")]
    try:
        cells = list(_cells((line for _, line in body), delimiter))
    except csv.Error as error:
        raise refusal(path, f"is no table of readings: {error}", "write one row a line") from None
    numbers = [body[end - 1][0] for _, end in cells]
    rows = [row for row, _ in cells]
    units: tuple[str, ...] = ()
    below = tuple(cell.strip(" ()[]") for cell in rows[0]) if rows else ()
    if any(below) and all(map(is_unit, below)):
        units = below
        rows, numbers = rows[1:], numbers[1:]
    return Layout(delimiter, titles, lines[at][0], units, rows, numbers)


def _titles(
    lines: list[tuple[int, str]], stated: str, needed: Collection[str]
) -> tuple[int, str, tuple[str, ...]] | None:
    """Return number, delimiter and titles of the first line that names a key and another quantity.

    Without such a line, the first one that names a key. Titles stand above the numbers.
    """
    only_key = None
    for at, (_, line) in enumerate(lines):
        delimiter = stated or max(_DELIMITERS, key=line.count)
        if delimiter not in line:
            delimiter = " "
        titles = tuple(title.strip() for title in _of_line(line.strip(), delimiter))
        named = quantities_of(titles)
        if named & set(needed) and len(titles) > 1:
            found = at, delimiter, titles
            if named - set(needed) - {"week"}:
                return found
            only_key = only_key or found
        if len(titles) > 1 and re.fullmatch(r"[-+]?\d+([.,]\d*)?", titles[0]):
            break
    return only_key


def _of_line(line: str, delimiter: str) -> list[str]:
    """Return the titles of a line, none where a cell is too long for a title.

    Blanks separate titles, but no title from its unit in brackets.
    """
    if delimiter == " ":
        return re.split(r"\s+(?![\[(])", line.lstrip("#").strip())
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return []


def _cells(lines: Iterable[str], delimiter: str) -> Iterator[tuple[list[str], int]]:
    """Yield the cells of each row, and the number of lines up to its end."""
    if delimiter == " ":
        yield from ((line.split(), k) for k, line in enumerate(lines, 1))
        return
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    for row in reader:
        yield row, reader.line_num
