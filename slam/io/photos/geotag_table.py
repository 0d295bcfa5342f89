"""Positions of photographs in a table beside them: ``filename,latitude,longitude,altitude``.

Programs that correct positions after the flight write such tables, so they are preferred to the tags.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from backend.wording import counted, either
from slam.core.errors import InputError
from slam.core.geodesy import position_fault
from slam.core.height_systems import UNKNOWN
from slam.core.messages import Message, note, warning
from slam.core.names import listed
from slam.core.streams import Gps
from slam.io.files import brief, read_text, refused_file, shown
from slam.io.gcp_list import FILE_NAME
from slam.io.photos.photo_set import Photo
from slam.io.photos.position import PhotoPosition
from slam.io.picture_names import PictureNames
from slam.io.recordings.tables.cells import decimal_mark, numbers, text_of
from slam.io.recordings.tables.columns import TIMES, Column, columns_of, quantities_of
from slam.io.recordings.tables.layout import Layout, layout_of

_MAX_BYTES = 1 << 26
_PLACE = ("latitude", "longitude")
_ALTITUDE_UNITS = dict.fromkeys(("altitude", "alt", "z/altitude"), "m")
_ACCURACIES = tuple(
    re.compile(rf"(({kind})[ _-]?(accuracy|acc|std)|(accuracy|acc|std)[ _-]?({kind}))( ?[\[(]m[\])])?", re.I)
    for kind in ("horizontal|horz|h|xy", "vertical|vert|v|z")
)
"""Titles of the standard deviations along the ground and up, in metres."""
_UP_RATIO = 2.0
"""Error of satellite positions up over that along the ground, where a table does not state it."""
_FAR_M = 1000.0
"""Positions that are corrected after the flight lie metres from those of the tags. So far off they are those
of other photographs, or have another order, sign or datum."""
_Geotags = Mapping[str, tuple[float, ...]]
"""Name of a picture as written -> latitude, longitude [deg], altitude, and standard deviations along
the ground and up [m]; NaN for what is not told."""


def with_geotags(
    photos: Sequence[Photo], folder: Path, beside: Sequence[Path]
) -> tuple[list[Photo], tuple[Message, ...]]:
    """Return photographs with the positions of the first table of them, and lines about the texts ``beside``.

    A photograph that the table does not name keeps the position of its tags.
    """
    remarks: list[Message] = []
    photos, unread, is_found = list(photos), [], False
    for path in beside:
        if path.name == FILE_NAME and path.parent == folder:
            continue
        name = shown(str(path.relative_to(folder)))
        layout = _layout(path, folder)
        known = quantities_of(layout.titles) if layout is not None else set()
        if layout is not None and not is_found and known >= {*_PLACE, "picture"}:
            try:
                geotags, faults = _geotags(path, layout)
            except InputError as refused:
                remarks.append(refused_file(refused, folder, "its positions are not used"))
                continue
            is_found = True
            photos, notes = _placed(photos, folder, name, geotags)
            remarks += [*notes, *(fault.named(name) for fault in faults)]
        elif known & set(TIMES):
            remarks.append(
                warning(f"{name} tells times of pictures and is not read here: give it itself, {path}")
            )
        else:
            unread.append(name)
    if unread:
        remarks.append(
            note(
                f"{counted(len(unread), 'file')} beside the photographs {either(len(unread), 'is', 'are')} "
                f"not read ({listed(unread)}): positions come from tags, or a table with the titles "
                f"filename, latitude, longitude, altitude [m]",
                f"control points from {FILE_NAME}",
            )
        )
    return photos, tuple(remarks)


def _layout(path: Path, folder: Path) -> Layout | None:
    """Return the cells of a table of pictures; None for another text."""
    try:
        return layout_of(path, read_text(path, folder, _MAX_BYTES)[0], ("picture",))
    except InputError:
        return None


def _geotags(path: Path, layout: Layout) -> tuple[_Geotags, tuple[Message, ...]]:
    """Return the positions of a table, and lines about its faults.

    Raises ``InputError`` for a unit that is not known.
    """
    found, unread = columns_of(path, layout.titles, layout.units, layout.line, _ALTITUDE_UNITS)
    for name, pattern in zip(("along", "up"), _ACCURACIES, strict=True):
        if title := next((title for title in unread if pattern.fullmatch(title)), None):
            found[name] = Column(name, title, list(layout.titles).index(title), "m", 1.0)
            unread.remove(title)
    mark = decimal_mark(path, layout, found.values())
    none = np.full(len(layout.rows), np.nan)
    read = {
        name: numbers(layout, found[name], mark) if name in found else (none, [])
        for name in (*_PLACE, "altitude", "along", "up")
    }
    faults: list[Message] = [line for _, lines in read.values() for line in lines]
    if unread:
        faults.append(note(f"columns that are not read: {listed(unread)}"))
    geotags, refused = {}, []
    values = np.column_stack([column for column, _ in read.values()])
    for name, row in zip(text_of(layout, found["picture"]), values.tolist(), strict=True):
        if np.isfinite(row[:2]).all() and (fault := position_fault(*row[:2])):
            refused.append(f"{brief(name, 40)}: {fault}")
        elif np.isfinite(row[:2]).all():
            geotags[name] = tuple(row)
    if refused:
        faults.append(warning(f"{counted(len(refused), 'position')} not used ({listed(refused)})"))
    return geotags, tuple(faults)


def _placed(
    photos: Sequence[Photo], folder: Path, name: str, geotags: _Geotags
) -> tuple[list[Photo], list[Message]]:
    """Return photographs with the positions of a table, and lines about it."""
    paths = (photo.path.relative_to(folder).as_posix() for photo in photos)
    matches = PictureNames.of([photo.name for photo in photos], paths).matched(geotags, folder.name)
    geotag_of = {picture: geotags[written] for written, picture in matches.picture.items()}
    placed, far, is_moved = list[Photo](), list[tuple[float, str]](), list[bool]()
    for photo in photos:
        geotag = geotag_of.get(photo.name)
        is_moved.append(geotag is not None)
        if geotag is not None:
            if (away_m := photo.tags.position.apart_m(*geotag[:2])) > _FAR_M:
                far.append((away_m, photo.name))
            photo = _at(photo, geotag)
        placed.append(photo)
    placed = _with_own_accuracy(placed, is_moved)
    remarks: list[Message] = [
        note(f"positions of {len(geotag_of)} of {len(photos)} photographs are those of {name}")
    ]
    if far:
        remarks.append(
            warning(
                f"{name} puts {counted(len(far), 'photograph')} up to {max(far)[0] / 1e3:.0f} km from the "
                f"places in their tags ({listed([photo for _, photo in far])}): check signs, order and "
                "datum of its coordinates"
            )
        )
    several = [*matches.ambiguous, *matches.unclear]
    if several:
        remarks.append(
            warning(
                f"{name} has positions of {counted(len(several), 'name')} that may be of several "
                "photographs, and none of these is used "
                f"({listed([brief(each, 40) for each in several])})",
                "write the folders too",
            )
        )
    if matches.unknown:
        names = listed([brief(each, 40) for each in sorted(matches.unknown)])
        remarks.append(
            warning(
                f"{name} has positions of {counted(len(matches.unknown), 'file')} that are none of them "
                f"({names})"
            )
        )
    return placed, remarks


def _with_own_accuracy(photos: Sequence[Photo], is_moved: Sequence[bool]) -> list[Photo]:
    """Return photographs none of which has the accuracy that another source states.

    The sources are the tags and the table, whose positions are those that are moved. One without an
    accuracy, where the other source states some, is as exact as that of a GPS without RTK.
    """
    states = {
        moved for photo, moved in zip(photos, is_moved, strict=True) if photo.tags.position.std_m is not None
    }
    return [
        photo.at(replace(photo.tags.position, std_m=Gps.noise_std_m))
        if photo.tags.position.std_m is None and (not moved) in states
        else photo
        for photo, moved in zip(photos, is_moved, strict=True)
    ]


def _at(photo: Photo, told: tuple[float, ...]) -> Photo:
    """Return a photograph at another place; without an altitude it keeps that of its tags, as exact as it is
    there."""
    latitude_deg, longitude_deg, altitude_m, along_m, up_m = told
    old = photo.tags.position
    if tells_altitude := bool(np.isfinite(altitude_m)):
        up_m = up_m if up_m > 0 else _UP_RATIO * along_m
    else:
        up_m = (old.std_m or Gps.noise_std_m)[2]
    position = PhotoPosition(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m if tells_altitude else old.altitude_m,
        height_system=UNKNOWN if tells_altitude else old.height_system,
        std_m=(along_m, along_m, up_m) if along_m > 0 else None,
        height_above_takeoff_m=old.height_above_takeoff_m,
    )
    return photo.at(position)
