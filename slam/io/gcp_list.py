"""Reading of OpenDroneMap's ``gcp_list.txt``: ground control points and the pixels that show them.

The first line names the coordinate system (`slam.io.survey_system`). Every other line is one view:
``x y z u v picture [name] [check]``, with blanks, tabs, commas or semicolons between. Longitude comes before
latitude. Source: OpenDroneMap's documentation, "Ground Control Points"; the word ``check``, which holds a
point out, is an addition. ``landmarks.csv`` with pixels is read too (`slam.io.landmark_views`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from slam.core.control_points import PictureView, Role, SurveyedPoint
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin, enu_from_geodetic, position_fault
from slam.core.messages import Line, Message, about, as_message, as_note
from slam.core.names import listed
from slam.core.surveyed_flight import faults_of
from slam.io.files import brief, read_text, refusal
from slam.io.landmark_views import has_views, listed_views
from slam.io.survey_system import NAME_IT, SurveySystem

Array = NDArray[np.float64]

FILE_NAME, LANDMARKS = "gcp_list.txt", "landmarks.csv"
MAX_BYTES = 1 << 24
FAR_M = 5000.0
"""A point farther from every fix is on no picture: flights of photographs cross some kilometres, at heights
below one."""
_ROW = "write x y z u v picture [name] [check]"


_Place = tuple[float, float, float | None]
"""x and y as written, and the height in metres; None for a height that is not a number."""


@dataclass(frozen=True)
class _Row:
    """One view of a point."""

    line: int
    place: _Place
    view: PictureView
    name: str
    is_check: bool


def read_gcp_list(path: Path, flight: Flight) -> tuple[tuple[SurveyedPoint, ...], list[Line]]:
    """Return the points of a file with views in the pictures of a flight, and notes on lines not used.

    Points whose coordinates contradict each other have a ``fault``. Raises ``InputError`` for a line that
    cannot be read, and where all points lie far from the flight.
    """
    text, notes = read_text(path, path.resolve().parent, MAX_BYTES)
    table = listed_views(path, text, flight) if has_views(text) else None
    if table is None:
        lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
        lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    else:
        lines = [(table.first, table.header), *table.lines]
    if not lines:
        raise refusal(path, "is empty", f"{NAME_IT}, and a line for each view of a point")
    first, header = lines[0]
    fields = _fields(header)
    if len(fields) >= 6 and _numbers(fields[:5]) is not None:
        raise refusal(path, "has a point in its first line, not a coordinate system", NAME_IT, first)
    system = SurveySystem.named(path, first, header)
    if len(lines) > 1 and not any(_numbers([field]) for field in _fields(lines[1][1])[:5]):
        del lines[1]  # titles of the columns
    pictures = _by_ending(() if flight.frames is None else flight.frames.names)
    rows = [_row(path, number, line, pictures, system.height_unit_m) for number, line in lines[1:]]
    if not rows:
        raise refusal(path, "holds no point", _ROW, first)
    rows, unknown = _in_flight(path, rows, flight, pictures)
    by_name: dict[str, list[_Row]] = {}
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
    origin = flight.geo_origin()
    in_world = origin is not None and table is not None and table.in_world
    heights = origin.height_system if in_world and origin is not None else system.height_system
    points = [
        replace(point, datum_std_m=float(np.nan_to_num(std_m)), height_system=heights) for point in points
    ]
    unit = system.unit_note if any(row.place[2] is not None for row in rows) else ""
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
        if not path.is_file() or not has_views(read_text(path, folder, MAX_BYTES)[0]):
            return flight
    flight = without_own_points(flight)  # lines that an import recorded about another list
    if flight.frames is None:
        said = as_note(f"{path.name} is not used: the flight has no pictures")
        return flight.with_warning(_named(path.name, said))
    try:
        points, notes = read_gcp_list(path, flight)
    except InputError as refused:
        reason = str(refused).removeprefix(f"{folder}/")
        return flight.with_warning(_named(path.name, f"{reason}; no control point is used"))
    lines = [*(_named(path.name, line) for line in notes), *(about(path.name, f) for f in faults_of(points))]
    return replace(flight, surveyed=points).with_warning(*lines)


def _named(name: str, line: Line) -> Message:
    """Return a message that begins with the name of a list as one about the list."""
    return replace(as_message(line), about=name)


def without_own_points(flight: Flight) -> Flight:
    """Return a flight as it is without a ``gcp_list.txt`` in its folder."""
    others = tuple(message for message in flight.messages if message.about not in (FILE_NAME, LANDMARKS))
    return replace(flight, surveyed=(), messages=others)


def _numbers(fields: list[str]) -> list[float] | None:
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None


def _fields(text: str) -> list[str]:
    """Return the fields of a line; commas are decimal ones where semicolons or tabs divide the fields."""
    for separator in ("\t", ";", ","):
        if text.count(separator) >= 5:
            fields = [field.strip() for field in text.split(separator)]
            decimal = separator != "," and any(re.fullmatch(r"-?\d+,\d+", field) for field in fields[:5])
            numbers = [field.replace(",", ".") if decimal else field for field in fields[:5]]
            return [field for field in (*numbers, *fields[5:]) if field]
    return text.split()


def _row(path: Path, line: int, text: str, pictures: Mapping[str, str], height_unit_m: float) -> _Row:
    fields = _fields(text)
    if len(fields) < 6:
        raise refusal(path, f"has {len(fields)} fields, fewer than 6", _ROW, line)
    numbers = _numbers(fields[:5])
    if numbers is None or not all(map(math.isfinite, (*numbers[:2], *numbers[3:]))):
        wrong = next(f for f in fields[:5] if _numbers([f]) is None or not math.isfinite(float(f)))
        raise refusal(path, f"holds {brief(wrong, 40)!r} where a number is needed", _ROW, line)
    x, y, z, u, v = numbers
    words = fields[5:]
    # A name of a picture may have blanks in it.
    ends = (end for end in range(len(words), 1, -1) if _picture(" ".join(words[:end]), pictures) is not None)
    end = next(ends, 1)
    picture, rest = " ".join(words[:end]), words[end:]
    is_check = "check" in (word.lower() for word in rest[1:])
    place = x, y, z * height_unit_m if math.isfinite(z) else None
    return _Row(line, place, PictureView(picture, u, v), rest[0] if rest else "", is_check)


def _in_flight(
    path: Path, rows: list[_Row], flight: Flight, names: Mapping[str, str]
) -> tuple[list[_Row], list[Line]]:
    """Return the rows of pictures of the flight, under its names of them, and a note about the others.

    ``names`` are those of `_by_ending`.
    """
    camera = flight.camera
    known, unknown = [], []
    elsewhere = _of_other_folders(path, rows, flight, names)
    for row in rows:
        found = None if row.view.picture in elsewhere else _picture(row.view.picture, names)
        is_bare = _file(row.view.picture) == row.view.picture
        if is_bare and (found == "" or (found is None and _is_ambiguous(row.view.picture, names))):
            what = f"names {brief(row.view.picture, 60)!r}, of which there are several"
            raise refusal(path, what, "write its folder too", row.line)
        if not found:  # of a folder whose pictures are not in the flight, as those of several others are
            unknown.append(row)
            continue
        width, height = camera.size_px if camera else (math.inf, math.inf)
        if not (-0.5 <= row.view.u_px <= width - 0.5 and -0.5 <= row.view.v_px <= height - 0.5):
            pixel = f"has the pixel {row.view.u_px:g} {row.view.v_px:g}"
            what = f"{pixel}, outside of {found} of {width} x {height} px"
            raise refusal(path, what, "give pixels of the pictures as they are", row.line)
        known.append(replace(row, view=row.view._replace(picture=found)))
    missing = list(dict.fromkeys(brief(row.view.picture, 60) for row in unknown))
    if not known:
        what = f"names {missing[0]!r}, no picture of the flight, and no other line names one"
        raise refusal(path, what, "write the names of its pictures", unknown[0].line)
    if not unknown:
        return known, []
    note = (
        f"{brief(path.name, 80)}, line {unknown[0].line}: no picture of the flight has this name; lines that "
        f"are not used: {len(unknown)}, of {listed(missing)}; check the names"
    )
    return known, [note]


def _of_other_folders(
    path: Path, rows: list[_Row], flight: Flight, names: Mapping[str, str]
) -> frozenset[str]:
    """Return the pictures that have only their file name in common with one of the flight: the list has that
    one too, with its folder. Raises ``InputError`` where no folder is known to be the flight's."""
    of: dict[str, dict[str, tuple[str, ...]]] = {}
    for row in rows:
        if found := _picture(row.view.picture, names):
            parts = PurePosixPath(row.view.picture.lower().replace("\\", "/")).parts
            of.setdefault(found, {})[row.view.picture] = parts
    others = set[str]()
    for found, written in of.items():
        folders = {picture: parts[-2] for picture, parts in written.items() if len(parts) > 1}
        if len({*folders.values()}) < 2:
            continue
        own = {flight.name.lower(), *PurePosixPath(found.lower()).parts[:-1]}
        strange = [
            each
            for each, folder in folders.items()
            if folder not in own and folder + "_" not in found.lower()
        ]
        if len(strange) == len(folders):
            what = f"names {brief(_file(found), 60)!r} in several folders, of which the flight has one"
            raise refusal(path, what, "keep the lines of that folder")
        others.update(strange)
    return frozenset(others)


def _by_ending(names: tuple[str, ...]) -> Mapping[str, str]:
    """Return lower-case name, file name or its stem -> name; empty where several have it."""
    found: dict[str, str] = {}
    for name in names:
        for key in {name.lower(), _file(name).lower(), PurePosixPath(name).stem.lower()}:
            found[key] = name if key not in found or key == name.lower() else ""
    return found


def _picture(written: str, names: Mapping[str, str]) -> str | None:
    """Return the flight's name of a picture, empty where several have the one that is written, None for none.

    Photographs of one name in several folders have the folders in their names, joined by ``_``
    (`slam.io.photos.search`).
    """
    parts = PurePosixPath(written.lower().replace("\\", "/")).parts
    endings = (written.lower(), *("_".join(parts[k:]) for k in range(len(parts))))
    return next((names[ending] for ending in endings if ending in names), None)


def _is_ambiguous(written: str, names: Mapping[str, str]) -> bool:
    """Return whether pictures of several folders have a file name that is written without a folder."""
    ending = f"_{_file(written).lower()}"
    return len({name for name in names.values() if name.lower().endswith(ending)}) > 1


def _file(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name


def _point(name: str, rows: list[_Row], geodetic: Mapping[_Place, tuple[float, ...]]) -> SurveyedPoint:
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


def _with_two_names(points: list[SurveyedPoint], by_name: Mapping[str, list[_Row]]) -> list[SurveyedPoint]:
    """Return the points with a fault for places that have two names."""
    named: dict[_Place, list[str]] = {}
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
