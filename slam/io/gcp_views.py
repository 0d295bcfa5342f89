"""Views of control points as a list writes them, and the lines of ``gcp_list.txt``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from slam.core.control_points import PictureView
from slam.io.files import brief, refusal
from slam.io.picture_names import PictureNames
from slam.io.survey_system import NAME_IT

ROW = "write x y z u v picture [name] [check]"
_HEIGHT = 2
"""Index of z in the numbers of a view."""


@dataclass(frozen=True)
class GcpView:
    """One view of a point. Numbers are as they are written."""

    line: int
    numbers: tuple[str, str, str, str, str]
    """x, y, z, and the column and the row of the pixel."""
    picture: str
    name: str
    """Empty for a point without a name."""
    is_check: bool


@dataclass(frozen=True)
class GcpViews:
    """The views of a list, and its coordinate system."""

    line: int
    """Number of the line that names the system."""
    system: str
    views: Iterable[GcpView]
    """Read when they are asked for, so that a fault of the system is reported before theirs."""
    height_system: str | None = None
    """Vertical datum of the heights; None for that of the coordinate system."""


Place = tuple[float, float, float | None]
"""x and y as written, and the height in metres; None for a height that is not a number."""


@dataclass(frozen=True)
class GcpRow:
    """One view of a point, in numbers."""

    line: int
    place: Place
    view: PictureView
    name: str
    is_check: bool


def row_of(path: Path, of: GcpView, height_unit_m: float) -> GcpRow:
    """Return a view in numbers. Raises ``InputError`` for one that is none; a height may be NaN."""
    wrong = [
        field
        for k, field in enumerate(of.numbers)
        if not is_number(field) or (k != _HEIGHT and not math.isfinite(float(field)))
    ]
    if wrong:
        raise refusal(path, f"holds {brief(wrong[0], 40)!r} where a number is needed", ROW, of.line)
    x, y, z, u, v = map(float, of.numbers)
    place = x, y, z * height_unit_m if math.isfinite(z) else None
    return GcpRow(of.line, place, PictureView(of.picture, u, v), of.name, of.is_check)


def views_of_text(path: Path, text: str, pictures: PictureNames) -> GcpViews:
    """Return the views of a ``gcp_list.txt``.

    Raises ``InputError`` for an empty list and for one without a system, and, while the views are read, for a
    line with too few fields.
    """
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    if not lines:
        raise refusal(path, "is empty", f"{NAME_IT}, and a line for each view of a point")
    first, header = lines[0]
    fields = _fields(header)
    if len(fields) >= 6 and all(map(is_number, fields[:5])):
        raise refusal(path, "has a point in its first line, not a coordinate system", NAME_IT, first)
    if len(lines) > 1 and not any(map(is_number, _fields(lines[1][1])[:5])):
        del lines[1]  # titles of the columns
    return GcpViews(first, header, (_view(path, number, line, pictures) for number, line in lines[1:]))


def is_number(field: str) -> bool:
    """Return whether a field is a number, which may be NaN or infinite."""
    try:
        float(field)
    except ValueError:
        return False
    return True


def _fields(text: str) -> list[str]:
    """Return the fields of a line; commas are decimal ones where semicolons or tabs divide the fields."""
    for separator in ("\t", ";", ","):
        if text.count(separator) >= 5:
            fields = [field.strip() for field in text.split(separator)]
            decimal = separator != "," and any(re.fullmatch(r"-?\d+,\d+", field) for field in fields[:5])
            numbers = [field.replace(",", ".") if decimal else field for field in fields[:5]]
            return [field for field in (*numbers, *fields[5:]) if field]
    return text.split()


def _view(path: Path, line: int, text: str, pictures: PictureNames) -> GcpView:
    fields = _fields(text)
    if len(fields) < 6:
        raise refusal(path, f"has {len(fields)} fields, fewer than 6", ROW, line)
    x, y, z, u, v, *words = fields
    # A name of a picture may have blanks in it.
    ends = (end for end in range(len(words), 1, -1) if pictures.find(" ".join(words[:end])) is not None)
    end = next(ends, 1)
    rest = words[end:]
    is_check = "check" in (word.lower() for word in rest[1:])
    return GcpView(line, (x, y, z, u, v), " ".join(words[:end]), rest[0] if rest else "", is_check)
