"""Columns of what may be wrong with pictures and instruments, named for terms and their parameters."""

from __future__ import annotations

from slam.criticism.camera.photometric import PICTURE_SHAPES, RESTLESS
from slam.criticism.camera.warps import WARPS
from slam.criticism.kalman.camera_parameters import CAMERA, SQUARES, catalogued
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.search import effects
from slam.simulation.terms import CATALOGUE

LATE = {f"{name}.s": parameter for name, (_, parameter) in effects.LATE.items()}
"""Columns of what no term is, and their parameters."""
PATTERNS = (*PICTURE_SHAPES, *WARPS)
"""What no term is, either."""
SIZE = ".size"
"""Behind a shape's name: its column."""
UNMEASURED = ("sonar_temperature.rise", "floor_slope.x", "floor_slope.y", "exposure_variation.gamma")
"""A drifting scale, of which a stretch has little; what healthy places differ by; and a variance that looks
much like another: brightness that wanders is told as that of the gain."""


def seen_by_pictures() -> list[str]:
    """Every error that pictures may tell of."""
    terms = [n for n in (*CAMERA, *SENSOR) if n.partition(".")[0] in CATALOGUE and n not in UNMEASURED]
    return [*terms, *LATE, *(name + SIZE for name in PATTERNS)]


def in_catalogue(column: str, size: float) -> float:
    """A column's size in the catalogue's unit: of a variance, the deviation."""
    if column in CAMERA:
        return catalogued(CAMERA.index(column), size)
    effect, _, parameter = column.rpartition(".")
    return size + CATALOGUE[effect].parameter(parameter).neutral


def is_square(column: str) -> bool:
    """Whether a column is a square, or a variance: its size cannot be negative."""
    if column in CAMERA:
        return CAMERA.index(column) in SQUARES
    return column.removesuffix(SIZE) in RESTLESS
