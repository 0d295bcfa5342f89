"""Rows of a list of control points, under the names that a flight has for their pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.names import listed
from slam.io.files import brief, refusal
from slam.io.gcp_views import GcpRow
from slam.io.picture_names import PictureNames, file_name


def rows_in_flight(
    path: Path, rows: Sequence[GcpRow], flight: Flight, names: PictureNames
) -> tuple[list[GcpRow], list[Message]]:
    """Return the rows of pictures of the flight, under its names of them, and a note about the others.

    ``names`` are those of the flight. Raises ``InputError`` for a picture that may be one of several, for a
    pixel outside of its picture, and where no row is left.
    """
    matches = names.matched((row.view.picture for row in rows), flight.name)
    if matches.unclear:
        picture = brief(file_name(matches.unclear[0]), 60)
        what = f"names {picture!r} in several folders, of which the flight has one"
        raise refusal(path, what, "keep the lines of that folder")
    known, unknown = [], []
    for row in rows:
        if row.view.picture in matches.ambiguous:
            what = f"names {brief(row.view.picture, 60)!r}, of which there are several"
            raise refusal(path, what, "write its folder too", row.line)
        found = matches.picture.get(row.view.picture)
        if found is None:  # of a folder whose pictures are not in the flight, as those of several others are
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
    said = warning(
        f"{brief(path.name, 80)}, line {unknown[0].line}: no picture of the flight has this name",
        f"lines that are not used: {len(unknown)}, of {listed(missing)}",
        "check the names",
    )
    return known, [said]


def _check_pixel(path: Path, row: GcpRow, flight: Flight, picture: str) -> None:
    """Raise ``InputError`` for a pixel outside of its picture."""
    width, height = flight.camera.size_px if flight.camera else (math.inf, math.inf)
    if not (-0.5 <= row.view.u_px <= width - 0.5 and -0.5 <= row.view.v_px <= height - 0.5):
        pixel = f"has the pixel {row.view.u_px:g} {row.view.v_px:g}"
        what = f"{pixel}, outside of {picture} of {width} x {height} px"
        raise refusal(path, what, "give pixels of the pictures as they are", row.line)
