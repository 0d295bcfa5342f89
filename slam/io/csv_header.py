"""Header of a ``data.csv``: names and units of the columns."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from slam.io.files import refusal

_TIME_UNITS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "µs": "microseconds"}
_GUESSES = {
    **dict.fromkeys(("mm", "mm s^-1", "mV"), "multiply by 0.001"),
    **dict.fromkeys(("cm", "%"), "multiply by 0.01"),
    **dict.fromkeys(("deg", "deg s^-1", "deg/s"), "multiply by pi/180"),
    "g": "multiply by 9.80665",
    "rad": "multiply by 180/pi",
    "ft": "multiply by 0.3048",
}
_SPELLINGS = {"rad/s": "rad s^-1", "m/s": "m s^-1", "m/s^2": "m s^-2", "m/s2": "m s^-2", "-": "1", "": "1"}
"""Other ways to write the format's units; EuRoC has [] for the quaternion's."""


@dataclass(frozen=True)
class CsvColumn:
    """One column of numbers, found by its name."""

    name: str
    unit: str
    limit: float
    """Largest possible magnitude: larger values count as missing, and many of them mean a wrong unit."""
    optional: bool = False

    @property
    def title(self) -> str:
        """Return the title in the header."""
        return f"{self.name} [{self.unit}]"

    @property
    def most(self) -> str:
        """Return the limit with its unit as text."""
        return f"{self.limit:g}" if self.unit == "1" else f"{self.limit:g} {self.unit}"

    @property
    def in_unit(self) -> str:
        """Return the unit as text."""
        return "plain numbers, 1 for the whole range" if self.unit == "1" else f"[{self.unit}]"


def header_of(columns: tuple[CsvColumn, ...]) -> str:
    """Return the header line of a stream with these columns."""
    return ",".join(["#timestamp [ns]", *(c.title for c in columns)])


def parse_header(path: Path, first: bytes, expected: str) -> list[str]:
    """Return the titles of the columns; check that the first is a stamp in nanoseconds."""
    try:
        line = first.decode("utf-8").strip().lstrip("#").strip()
    except UnicodeDecodeError:
        raise refusal(path, "is not a text file", f"its first line is to be {expected}", 1) from None
    titles = [t.strip().strip('"') for t in line.split(",")]
    name, unit = _split(titles[0])
    if name.lower() not in ("timestamp", "time", "stamp", "t"):
        is_row = re.fullmatch(r"[-+0-9.eE]+", titles[0])
        what = "has no header line" if is_row else f"starts with {titles[0][:40]!r}"
        if len(titles) == 1 and re.search(r"[;\t]", line):
            what = "separates its columns with something else than commas"
        raise refusal(path, what, f"write {expected} there", 1)
    if unit not in ("ns", None):
        known = _TIME_UNITS.get(unit, "an unknown unit")
        raise refusal(path, f"gives stamps in {known} ([{unit}])", "convert them to integers in [ns]", 1)
    return titles


def _split(title: str) -> tuple[str, str | None]:
    """Name and unit of ``name [unit]``; None where it has no unit."""
    found = re.fullmatch(r"([^\[]*)\[([^\]]*)\]", title)
    return (found[1].strip(), found[2].strip()) if found else (title.strip(), None)


def column_indices(path: Path, header: list[str], columns: tuple[CsvColumn, ...]) -> list[int | None]:
    """Return the index of each column in a row; None for an absent optional one."""
    titles = [_split(t) for t in header[1:]]
    names = [name for name, _ in titles]
    found: list[int | None] = []
    for column in columns:
        if names.count(column.name) > 1:
            raise refusal(path, f"has the column {column.name} twice", "keep one of them", 1)
        if column.name not in names:
            if not column.optional:
                raise refusal(path, f"has no column {column.title}", f"the header is {header_of(columns)}", 1)
            found.append(None)
            continue
        at = names.index(column.name)
        unit = titles[at][1]
        if unit is not None and _SPELLINGS.get(unit, unit) != _SPELLINGS.get(column.unit, column.unit):
            guess = _GUESSES.get(unit)
            do = f"convert it to {column.in_unit}" + (f" ({guess})" if guess else "")
            raise refusal(path, f"gives {column.name} in [{unit}]", do, 1)
        found.append(at + 1)
    return found


def extra_columns(header: list[str], columns: tuple[CsvColumn, ...]) -> list[str]:
    """Return the titles of unknown columns, the stamp excepted."""
    known = {c.name for c in columns}
    return [t for t in header[1:] if _split(t)[0] not in known]
