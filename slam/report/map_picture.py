"""The pictures of mosaics in a report: with the landmarks of an evaluation, and with surveyed points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from slam.report.mosaic_marks import MapMarks, Mark
from slam.report.page import embedded
from slam.report.pictures import thumbnail

if TYPE_CHECKING:
    from slam.core.control_points import ControlReport
    from slam.report.accuracy import Evaluated

MAP, CHAIN = "mosaic.png", "mosaic_chain.png"


def picture(path: Path | None, marks: MapMarks | None = None) -> str | None:
    """Return a picture as a data address, with marks if it has a world file; None without the file."""
    if path is None or not path.exists():
        return None
    placed = path.with_suffix(".pgw").exists()
    return embedded(thumbnail(path, marks=marks if placed else None), "jpeg")


def map_picture(path: Path | None, marks: MapMarks, evaluated: Evaluated) -> str | None:
    """Return the picture of a map with the landmarks that were compared where that map has them.

    The map of the plain chain, ``mosaic_chain.png``, has them elsewhere than the optimized one.
    """
    if path is None:
        return None
    places = evaluated.chain_landmarks if path.name == CHAIN else evaluated.landmarks
    return picture(path, replace(marks, points=(*marks.points, *(Mark(*place) for place in places))))


def surveyed_marks(report: ControlReport | None) -> tuple[Mark, ...]:
    """Return the control and check points whose survey places them on the ground of the map."""
    points = () if report is None else report.points
    return tuple(Mark(p.name, *p.surveyed_m[:2], True) for p in points if p.surveyed_m is not None)
