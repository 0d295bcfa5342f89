"""The pictures of mosaics in a report, with the landmarks of an evaluation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from slam.report.mosaic_marks import MapMarks
from slam.report.page import embedded
from slam.report.pictures import thumbnail

if TYPE_CHECKING:
    from slam.report.accuracy import Evaluated


def picture(path: Path | None, marks: MapMarks | None = None) -> str | None:
    """Return a picture as a data address, with marks if it has a world file; None without the file."""
    if path is None or not path.exists():
        return None
    placed = path.with_suffix(".pgw").exists()
    return embedded(thumbnail(path, marks=marks if placed else None), "jpeg")


def map_picture(path: Path | None, marks: MapMarks, evaluated: Evaluated) -> str | None:
    """Return the picture of the optimized map with the landmarks that were compared on it."""
    return picture(path, replace(marks, landmarks=evaluated.landmarks_m))
