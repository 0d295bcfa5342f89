"""``landmarks.csv`` with the pixels of its points: control points in the form of ``gcp_list.txt``.

Beside ``name``, ``x``, ``y`` and ``z`` it has the columns ``image``, ``px`` and ``py``, a row for each view,
and a ``check`` column if points are held out. A first line such as ``# EPSG:25832`` names the coordinate
system; without it x, y and z are metres in the axes of the flight's world.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.core.flight import Flight
from slam.core.geodesy import geodetic_from_enu
from slam.io.files import refusal

_POINT, _VIEW = ("name", "x", "y", "z"), ("image", "px", "py")
_NO = ("", "0", "no", "false")
"""Words in the column ``check`` of a point that the map follows."""
_WORLD = "EPSG:4326"
"""System into whose degrees places in the axes of the world are brought."""


@dataclass(frozen=True)
class ListedViews:
    """The lines of a list of control points that a table holds."""

    first: int
    header: str
    """The coordinate system, and the number of its line."""
    lines: list[tuple[int, str]]
    """Number of a line, and what it would be in ``gcp_list.txt``."""
    in_world: bool
    """Whether the table has its points in the axes of the world."""


def has_views(text: str) -> bool:
    """Return whether a text is a table of landmarks with pixels."""
    return _titles(text.splitlines()) is not None


def image_column(text: str) -> int | None:
    """Return the column of pictures of a table in the axes of the world; None for another table."""
    found = _titles(text.splitlines())
    return found[1].index("image") if found is not None and found[0] == 0 else None


def listed_views(path: Path, text: str, flight: Flight) -> ListedViews:
    """Return the views of a table for which `has_views` is true; rows without a picture are left out.

    Raises ``InputError`` with the line that cannot be read, and for points in the axes of a world without a
    place on Earth.
    """
    lines = text.splitlines()
    found = _titles(lines)
    assert found is not None
    row, titles = found
    header = lines[0].lstrip("# ").strip() if row else _WORLD
    origin = flight.geo_origin()
    if not row and origin is None:
        what = "has points in the axes of the world, and the flight has no place on Earth"
        raise refusal(path, what, "name their coordinate system in a first line, such as # EPSG:25832", 1)
    views = []
    for number, fields in enumerate(csv.reader(io.StringIO("\n".join(lines[row + 1 :]))), row + 2):
        if not any(field.strip() for field in fields):
            continue
        if len(fields) != len(titles):
            what = f"has {len(fields)} fields instead of {len(titles)}"
            raise refusal(path, what, "repair the line", number)
        cells = dict(zip(titles, (field.strip() for field in fields), strict=True))
        if not cells["image"]:
            continue
        if not cells["name"]:
            raise refusal(path, "has no name", "name the landmark", number)
        place = [cells[axis] for axis in "xyz"]
        if not row and origin is not None:
            try:
                w_p = np.array([[float(each) for each in place]])
            except ValueError:
                raise refusal(path, "has no number for x, y or z", "write three numbers", number) from None
            has_height = bool(np.isfinite(w_p[0, 2])) and origin.altitude_known
            w_p[0, 2] = w_p[0, 2] if has_height else 0.0
            latitude, longitude, altitude = (float(each[0]) for each in geodetic_from_enu(w_p, origin))
            place = [repr(longitude), repr(latitude), repr(altitude if has_height else math.nan)]
        held_out = ["check"] if cells.get("check", "").lower() not in _NO else []
        cells_of_list = [*place, cells["px"], cells["py"], cells["image"], cells["name"], *held_out]
        views.append((number, "\t".join(cells_of_list)))
    return ListedViews(1 if row else row + 1, header, views, in_world=not row)


def _titles(lines: list[str]) -> tuple[int, list[str]] | None:
    """Return the index of the line of titles, 0 or 1, and these without units; None for another table."""
    for row, line in enumerate(lines[:2]):
        titles = [title.split("[")[0].strip().lstrip("#").strip() for title in line.split(",")]
        if {*_POINT, *_VIEW} <= set(titles):
            return row, titles
    return None
