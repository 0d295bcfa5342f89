"""Rows and titles of ``landmarks.csv``, with the first line that may name a coordinate system."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from slam.io.files import refusal

HEADER = ("name", "x [m]", "y [m]", "z [m]")
_POINT, _VIEW = ("name", "x", "y", "z"), ("image", "px", "py")


@dataclass(frozen=True)
class LandmarkTable:
    """The text of a table, taken apart as far as its titles."""

    path: Path
    system: str
    """Name of the coordinate system in the line before the titles; empty without such a line."""
    titles: tuple[str, ...]
    """As they are written, with their units."""
    text: str
    """The lines behind the titles."""
    line: int
    """Number of the line with the titles."""

    @staticmethod
    def of(path: Path, text: str) -> LandmarkTable:
        """Return the table of a text. Its titles stand in the first line, or in the second one."""
        first, _, others = text.replace("\r\n", "\n").replace("\r", "\n").partition("\n")
        second, _, behind = others.partition("\n")
        if not _are_of_views(_titles(first)) and _are_of_views(_titles(second)):
            return LandmarkTable(path, first.lstrip("# ").strip(), _titles(second), behind, 2)
        return LandmarkTable(path, "", _titles(first), others, 1)

    @property
    def has_views(self) -> bool:
        """Whether it has the pixels of its points."""
        return _are_of_views(self.titles)

    @property
    def is_in_world(self) -> bool:
        """Whether its points are in the axes of the world."""
        return self.line == 1

    @property
    def names(self) -> list[str]:
        """The titles without units."""
        return list(map(_name, self.titles))

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the number of its line, and the fields, of each row that is not blank.

        Raises ``InputError`` for a row that is damaged.
        """
        rows = csv.reader(io.StringIO(self.text))
        try:
            for fields in rows:
                if any(field.strip() for field in fields):
                    yield self.line + rows.line_num, [field.strip() for field in fields]
        except csv.Error as error:
            what, do = f"is not a csv file ({error})", f"write {','.join(HEADER)}"
            raise refusal(self.path, what, do, self.line + rows.line_num) from None

    def shows(self, fields: list[str]) -> bool:
        """Return whether a row is a view: it names a picture."""
        column = self.names.index("image") if self.has_views else len(fields)
        return column < len(fields) and bool(fields[column])

    def cells(self, line: int, fields: list[str]) -> dict[str, str]:
        """Return column -> field of a row. Raises ``InputError`` for too many of them, or too few."""
        if len(fields) != len(self.titles):
            what = f"has {len(fields)} fields instead of {len(self.titles)}"
            raise refusal(self.path, what, "repair the line", line)
        return dict(zip(self.names, fields, strict=True))

    def name(self, line: int, cells: dict[str, str]) -> str:
        """Return the name of the point of a row. Raises ``InputError`` if it is empty."""
        if not cells["name"]:
            raise refusal(self.path, "has no name", "name the landmark", line)
        return cells["name"]

    def check_metres(self) -> None:
        """Raise ``InputError`` if a column of points is lacking, or names another unit than metres."""
        if not all(
            title in self.titles or name in self.titles for title, name in zip(HEADER, _POINT, strict=True)
        ):
            found = ",".join(self.titles)[:80]
            raise refusal(self.path, f"has the header {found!r}", f"write {','.join(HEADER)}", self.line)


def _titles(line: str) -> tuple[str, ...]:
    try:
        return tuple(title.strip().lstrip("#").strip() for title in next(csv.reader([line]), []))
    except csv.Error:  # a field of more than 131072 letters
        return ()


def _name(title: str) -> str:
    return title.split("[")[0].strip()


def _are_of_views(titles: tuple[str, ...]) -> bool:
    return {*_POINT, *_VIEW} <= {*map(_name, titles)}
