"""Rows of a list of control points, under the names that a flight has for their pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from slam.core.flight import Flight
from slam.core.messages import Line
from slam.core.names import listed
from slam.io.files import brief, refusal
from slam.io.gcp_views import GcpRow
from slam.io.picture_names import PictureNames, file_name, parts_of


def rows_in_flight(
    path: Path, rows: Sequence[GcpRow], flight: Flight, names: PictureNames
) -> tuple[list[GcpRow], list[Line]]:
    """Return the rows of pictures of the flight, under its names of them, and a note about the others.

    ``names`` are those of the flight. Raises ``InputError`` for a picture that may be one of several, for a
    pixel outside of its picture, and where no row is left.
    """
    known, unknown = [], []
    elsewhere = _of_other_folders(path, rows, flight, names)
    for row in rows:
        if names.is_ambiguous(row.view.picture):
            what = f"names {brief(row.view.picture, 60)!r}, of which there are several"
            raise refusal(path, what, "write its folder too", row.line)
        found = None if row.view.picture in elsewhere else names.find(row.view.picture)
        if not found:  # of a folder whose pictures are not in the flight, as those of several others are
            unknown.append(row)
            continue
        _check_pixel(path, row, flight, found)
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


def _check_pixel(path: Path, row: GcpRow, flight: Flight, picture: str) -> None:
    """Raise ``InputError`` for a pixel outside of its picture."""
    width, height = flight.camera.size_px if flight.camera else (math.inf, math.inf)
    if not (-0.5 <= row.view.u_px <= width - 0.5 and -0.5 <= row.view.v_px <= height - 0.5):
        pixel = f"has the pixel {row.view.u_px:g} {row.view.v_px:g}"
        what = f"{pixel}, outside of {picture} of {width} x {height} px"
        raise refusal(path, what, "give pixels of the pictures as they are", row.line)


def _of_other_folders(
    path: Path, rows: Sequence[GcpRow], flight: Flight, names: PictureNames
) -> frozenset[str]:
    """Return the pictures that have only their file name in common with one of the flight: the list has that
    one too, with its folder. Raises ``InputError`` where no folder is known to be the flight's."""
    written_of: dict[str, list[str]] = {}
    for picture in dict.fromkeys(row.view.picture for row in rows):
        if found := names.find(picture):
            written_of.setdefault(found, []).append(picture)
    others = set[str]()
    for found, written in written_of.items():
        folders = {each: parts[-2] for each in written if len(parts := parts_of(each)) > 1}
        if len({*folders.values()}) < 2:
            continue
        own = {flight.name.lower(), *PurePosixPath(found.lower()).parts[:-1]}
        strange = [
            each
            for each, folder in folders.items()
            if folder not in own and folder + "_" not in found.lower()
        ]
        if len(strange) == len(folders):
            what = f"names {brief(file_name(found), 60)!r} in several folders, of which the flight has one"
            raise refusal(path, what, "keep the lines of that folder")
        others.update(strange)
    return frozenset(others)
