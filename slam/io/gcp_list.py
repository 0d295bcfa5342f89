"""Reading of OpenDroneMap's ``gcp_list.txt``: ground control points and the pixels that show them.

The first line names the coordinate system (`slam.io.survey_system`). Every other line is one view:
``x y z u v picture [name] [check]``, with blanks, tabs, commas or semicolons between. Longitude comes before
latitude. Source: OpenDroneMap's documentation, "Ground Control Points"; the word ``check``, which holds a
point out, is an addition. ``landmarks.csv`` with pixels is read too (`slam.io.landmark_views`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.control_points import PictureView, Role, SurveyedPoint
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, position_fault
from slam.core.messages import Message, note, recorded
from slam.core.names import listed
from slam.core.surveyed_flight import faults_of
from slam.io.files import read_text, refusal
from slam.io.gcp_pictures import rows_in_flight
from slam.io.gcp_views import ROW, GcpRow, Place, row_of, views_of_text
from slam.io.landmark_table import LandmarkTable
from slam.io.landmark_views import views_of_table
from slam.io.picture_names import PictureNames
from slam.io.survey_system import SurveySystem

Array = NDArray[np.float64]

FILE_NAME, LANDMARKS = "gcp_list.txt", "landmarks.csv"
MAX_BYTES = 1 << 24
FAR_M = 5000.0
"""A point farther from every fix is on no picture: flights of photographs cross some kilometres, at heights
below one."""


def read_gcp_list(path: Path, flight: Flight) -> tuple[tuple[SurveyedPoint, ...], list[Message]]:
    """Return the points of a file with views in the pictures of a flight, and notes on lines not used.

    Points whose coordinates contradict each other have a ``fault``. Raises ``InputError`` for a line that
    cannot be read, and where all points lie far from the flight.
    """
    text, notes = read_text(path, path.resolve().parent, MAX_BYTES)
    table = LandmarkTable.of(path, text)
    pictures = PictureNames.of(() if flight.frames is None else flight.frames.names)
    if table.has_views:
        views = views_of_table(table, flight.geo_origin())
    else:
        views = views_of_text(path, text, pictures)
    system = SurveySystem.named(path, views.line, views.system)
    rows = [row_of(path, view, system.height_unit_m) for view in views.views]
    if not rows:
        raise refusal(path, "holds no point", ROW, views.line)
    rows, unknown = rows_in_flight(path, rows, flight, pictures)
    by_name: dict[str, list[GcpRow]] = {}
    places = list(dict.fromkeys(row.place for row in rows))
    for row in rows:
        by_name.setdefault(row.name or f"GCP {places.index(row.place) + 1}", []).append(row)
    degrees = system.geodetic(np.array(places)[:, :2].astype(float))
    geodetic = {place: tuple(row) for place, row in zip(places, degrees.tolist(), strict=True)}
    points = [_point(name, of, geodetic) for name, of in by_name.items()]
    points = _with_two_names(points, by_name)
    firsts = np.array([by_name[point.name][0].place[:2] for point in points])
    first_known = next((place for place in geodetic.values() if np.isfinite(place).all()), None)
    std_m = 0.0 if first_known is None else system.datum_std_m(*first_known)
    heights = system.height_system if views.height_system is None else views.height_system
    points = [
        replace(point, datum_std_m=float(np.nan_to_num(std_m)), height_system=heights) for point in points
    ]
    unit = system.unit_note if any(row.place[2] is not None for row in rows) else None
    said = [line for line in (*notes, system.datum_note(std_m), unit) if line]
    return _near_flight(path, points, flight, firsts, system), [*said, *unknown]


def with_own_points(flight: Flight, folder: Path) -> Flight:
    """Return a flight with the control points of ``gcp_list.txt`` in its folder, if there is such a file.

    Without one they are those of ``landmarks.csv``, if it has pixels. Most commands need no control points,
    so a list that cannot be used is a warning.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        path = folder / LANDMARKS
        if not (path.is_file() and LandmarkTable.of(path, read_text(path, folder, MAX_BYTES)[0]).has_views):
            return flight
    flight = without_own_points(flight)  # lines that an import recorded about another list
    if flight.frames is None:
        said = note(f"{path.name} is not used: the flight has no pictures")
        return flight.with_warning(said.concerning(path.name))
    try:
        points, notes = read_gcp_list(path, flight)
    except InputError as refused:
        said = recorded(str(refused).removeprefix(f"{folder}/")).extended("no control point is used")
        return flight.with_warning(said.concerning(path.name))
    of_list = [line.concerning(path.name) for line in notes]
    faults = [fault.named(path.name) for fault in faults_of(points)]
    return replace(flight, surveyed=points).with_warning(*of_list, *faults)


def without_own_points(flight: Flight) -> Flight:
    """Return a flight as it is without a ``gcp_list.txt`` in its folder."""
    others = tuple(message for message in flight.messages if message.about not in (FILE_NAME, LANDMARKS))
    return replace(flight, surveyed=(), messages=others)


def _point(name: str, rows: list[GcpRow], geodetic: Mapping[Place, tuple[float, ...]]) -> SurveyedPoint:
    place = rows[0].place
    longitude, latitude = geodetic[place]
    views = tuple(dict.fromkeys(row.view for row in rows))
    fault = ""
    if other := next((row for row in rows if row.place != place), None):
        fault = f"lines {rows[0].line} and {other.line} give it different coordinates"
    elif len({view.picture for view in views}) < len(views):
        fault = f"one picture shows it at two places ({listed(_repeated(views))})"
    elif not math.isfinite(longitude + latitude):
        fault = f"line {rows[0].line} has coordinates that its system does not hold"
    elif wrong := position_fault(latitude, longitude):
        fault = f"line {rows[0].line}: {wrong}"
    role: Role = "check" if any(row.is_check for row in rows) else "control"
    altitude_m = math.nan if place[2] is None else place[2]
    named = bool(rows[0].name)
    return SurveyedPoint(name, latitude, longitude, altitude_m, views, role=role, fault=fault, is_named=named)


def _repeated(views: tuple[PictureView, ...]) -> list[str]:
    pictures = [view.picture for view in views]
    return list(dict.fromkeys(name for name in pictures if pictures.count(name) > 1))


def _with_two_names(points: list[SurveyedPoint], by_name: Mapping[str, list[GcpRow]]) -> list[SurveyedPoint]:
    """Return the points with a fault for places that have two names."""
    named: dict[Place, list[str]] = {}
    for point in points:
        named.setdefault(by_name[point.name][0].place, []).append(point.name)
    twice = {name: names for names in named.values() if len(names) > 1 for name in names}
    return [
        replace(p, fault=p.fault or f"one place has {len(twice[p.name])} names ({listed(twice[p.name])})")
        if p.name in twice
        else p
        for p in points
    ]


def _near_flight(
    path: Path, points: list[SurveyedPoint], flight: Flight, xy: Array, system: SurveySystem
) -> tuple[SurveyedPoint, ...]:
    """Return the points with a fault for those far from all fixes. Raises ``InputError`` if all are.

    ``xy`` (n, 2) are their coordinates as written.
    """
    away_m = _away_m(np.array([(p.longitude_deg, p.latitude_deg) for p in points]), flight)
    if (away_m > FAR_M).all():
        if (_away_m(system.geodetic(xy[:, ::-1]), flight) < FAR_M).any():
            first, second = system.axes
            what, do = f"has {first} and {second} swapped", f"write the {first} before the {second}"
        else:
            far = f"{1e-3 * away_m.min():.0f} km or more" if np.isfinite(away_m).any() else "too far"
            what, do = f"has all points {far} from the pictures", "check its coordinate system"
        raise refusal(path, what, do)
    return tuple(
        replace(p, fault=p.fault or f"it lies {1e-3 * d:.0f} km from the pictures") if d > FAR_M else p
        for p, d in zip(points, away_m.tolist(), strict=True)
    )


def _away_m(degrees: Array, flight: Flight) -> Array:
    """Return the distance (n,) of places (longitude, latitude) (n, 2) from all fixes; 0 without any."""
    gps, origin = flight.gps, flight.geo_origin()
    if gps is None or origin is None:
        return np.zeros(len(degrees))
    level = GeoOrigin(origin.latitude_deg, origin.longitude_deg, 0.0)
    fixes = enu_from_geodetic(gps.latitude_deg, gps.longitude_deg, 0.0, level)[:, :2]
    fixes = fixes[np.isfinite(fixes).all(axis=1)]
    if not len(fixes):
        return np.zeros(len(degrees))
    longitude, latitude = degrees.T
    places = enu_from_geodetic(latitude, longitude, 0.0, level)[:, :2]
    away = np.linalg.norm(places[:, None] - fixes[None], axis=2).min(axis=1)
    # A place beyond the pole has no distance.
    return np.where(np.isfinite(away) & (np.abs(latitude) <= 90), away, np.inf)
