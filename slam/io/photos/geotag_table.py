"""Positions of photographs in a table beside them: ``filename,latitude,longitude,altitude``.

Programs that correct positions after the flight write such tables, so they are preferred to the tags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from backend.wording import counted, either
from slam.core.errors import InputError
from slam.core.geodesy import position_fault
from slam.core.messages import Note
from slam.core.names import listed
from slam.io.files import brief, read_text, shown
from slam.io.gcp_list import FILE_NAME
from slam.io.photos.photo_set import Photo
from slam.io.recordings.tables.cells import decimal_mark, numbers, text_of
from slam.io.recordings.tables.columns import TIMES, columns_of, quantities_of
from slam.io.recordings.tables.layout import Layout, layout_of

_MAX_BYTES = 1 << 26
_PLACE = ("latitude", "longitude")
_Geotags = Mapping[str, tuple[float, float, float]]
"""Name of a picture in small letters -> latitude, longitude [deg] and altitude [m], NaN for none."""


def with_geotags(
    photos: Sequence[Photo], folder: Path, beside: Sequence[Path]
) -> tuple[list[Photo], tuple[str, ...]]:
    """Return photographs with the positions of the first table of them, and lines about the texts ``beside``.

    A photograph that the table does not name keeps the position of its tags.
    """
    remarks: list[str] = []
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
                remarks.append(f"{str(refused).removeprefix(f'{folder}/')}; its positions are not used")
                continue
            is_found = True
            photos, notes = _placed(photos, folder, name, geotags)
            remarks += [*notes, *(f"{name}: {fault}" for fault in faults)]
        elif known & set(TIMES):
            remarks.append(f"{name} tells times of pictures and is not read here: give it itself, {path}")
        else:
            unread.append(name)
    if unread:
        remarks.append(
            Note(
                f"{counted(len(unread), 'file')} beside the photographs {either(len(unread), 'is', 'are')} "
                f"not read ({listed(unread)}): positions come from tags, or a table with the titles "
                f"filename, latitude, longitude, altitude [m]; control points from {FILE_NAME}"
            )
        )
    return photos, tuple(remarks)


def _layout(path: Path, folder: Path) -> Layout | None:
    """Return the cells of a table of pictures; None for another text."""
    try:
        return layout_of(path, read_text(path, folder, _MAX_BYTES)[0], ("picture",))
    except InputError:
        return None


def _geotags(path: Path, layout: Layout) -> tuple[_Geotags, tuple[str, ...]]:
    """Return the positions of a table, and lines about its faults.

    Raises ``InputError`` for a unit that is not known.
    """
    found, _ = columns_of(path, layout.titles, layout.units, layout.line, {"altitude": "m", "alt": "m"})
    mark = decimal_mark(path, layout, found.values())
    read = [numbers(layout, found[name], mark) for name in (*_PLACE, "altitude") if name in found]
    values = [column for column, _ in read]
    if "altitude" not in found:
        values.append(np.full(len(layout.rows), np.nan))
    names = text_of(layout, found["picture"])
    geotags = {
        name.casefold(): row
        for name, row in zip(names, zip(*values, strict=True), strict=True)
        if np.isfinite(row[:2]).all() and not position_fault(*row[:2])
    }
    return geotags, tuple(line for _, faults in read for line in faults)


def _placed(
    photos: Sequence[Photo], folder: Path, name: str, geotags: _Geotags
) -> tuple[list[Photo], list[str]]:
    """Return photographs with the positions of a table, and lines about it."""
    same = Counter(photo.path.name.casefold() for photo in photos)
    placed, used = [], set[str]()
    for photo in photos:
        inner = photo.path.relative_to(folder).as_posix().casefold()
        bare = photo.path.name.casefold()
        key = inner if inner in geotags or same[bare] > 1 else bare
        if key in geotags:
            used.add(key)
            photo = _at(photo, *geotags[key])
        placed.append(photo)
    remarks: list[str] = [Note(f"positions of {len(used)} of {len(photos)} photographs are those of {name}")]
    if other := sorted(set(geotags) - used):
        names = listed([brief(each, 40) for each in other])
        remarks.append(
            f"{name} has positions of {counted(len(other), 'file')} that are none of them ({names})"
        )
    return placed, remarks


def _at(photo: Photo, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Photo:
    """Return a photograph at another place; without an altitude it keeps that of its tags."""
    old = photo.tags.position
    position = replace(
        old,
        latitude_deg=float(latitude_deg),
        longitude_deg=float(longitude_deg),
        altitude_m=float(altitude_m) if np.isfinite(altitude_m) else old.altitude_m,
        exif_altitude_m=None,
        std_m=None,
        unsigned_deg=None,
        datum="",
        faults=(),
    )
    return replace(photo, tags=replace(photo.tags, position=position))
