"""``landmarks.csv`` with the pixels of its points: control points in the form of ``gcp_list.txt``.

Beside ``name``, ``x``, ``y`` and ``z`` it has the columns ``image``, ``px`` and ``py``, a row for each view,
and a ``check`` column if points are held out. A first line such as ``# EPSG:25832`` names the coordinate
system; without it x, y and z are metres in the axes of the flight's world.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.io.files import refusal
from slam.io.gcp_views import GcpView, GcpViews
from slam.io.landmark_table import LandmarkTable

_NO = ("", "0", "no", "false")
"""Words in the column ``check`` of a point that the map follows."""
_WORLD = "EPSG:4326"
"""System into whose degrees places in the axes of the world are brought."""


def views_of_table(table: LandmarkTable, origin: GeoOrigin | None) -> GcpViews:
    """Return the views of a table that has some, in a flight with this origin; rows without a picture are
    left out.

    Raises ``InputError`` for points in the axes of a world without a place on Earth, and, while the views are
    read, with the line that cannot be.
    """
    if not table.is_in_world:
        return GcpViews(1, table.system, _views(table, None))
    if origin is None:
        what = "has points in the axes of the world, and the flight has no place on Earth"
        do = "name their coordinate system in a first line, such as # EPSG:25832"
        raise refusal(table.path, what, do, table.line)
    table.check_metres()
    return GcpViews(table.line, _WORLD, _views(table, origin), height_system=origin.height_system)


def _views(table: LandmarkTable, origin: GeoOrigin | None) -> Iterator[GcpView]:
    """Yield the views; places are brought from the axes of the world at ``origin`` into degrees."""
    for line, fields in table.rows():
        cells = table.cells(line, fields)
        if not table.shows(fields):
            continue
        name = table.name(line, cells)
        place = (cells["x"], cells["y"], cells["z"])
        if origin is not None:
            place = _on_earth(table, line, cells, origin)
        is_check = cells.get("check", "").lower() not in _NO
        yield GcpView(line, (*place, cells["px"], cells["py"]), cells["image"], name, is_check)


def _on_earth(
    table: LandmarkTable, line: int, cells: Mapping[str, str], origin: GeoOrigin
) -> tuple[str, str, str]:
    """Return longitude, latitude and altitude of a row; NaN for an altitude that is not known."""
    try:
        w_p = np.array([[float(cells[axis]) for axis in "xyz"]])
    except ValueError:
        raise refusal(table.path, "has no number for x, y or z", "write three numbers", line) from None
    has_height = bool(np.isfinite(w_p[0, 2])) and origin.altitude_known
    w_p[0, 2] = w_p[0, 2] if has_height else 0.0
    latitude, longitude, altitude = (float(each[0]) for each in geodetic_from_enu(w_p, origin))
    return repr(longitude), repr(latitude), repr(altitude if has_height else math.nan)
