"""Names of the columns of errors of pictures and instruments: terms and their parameters."""

from __future__ import annotations

from slam.criticism.camera.photometric import PICTURE_PATTERNS, VARIANCE_PATTERNS
from slam.criticism.camera.warps import WARPS
from slam.criticism.kalman.filter_parameters import CAMERA, SQUARES, catalogued
from slam.criticism.kalman.readings import SENSOR
from slam.criticism.search import effects
from slam.simulation.terms import CATALOGUE

LATE = {f"{name}.s": parameter for name, (_, parameter) in effects.LATE.items()}
"""Columns of delays, which are no terms, and their parameters."""
PATTERNS = (*PICTURE_PATTERNS, *WARPS)
"""Patterns of pictures, which are no terms either."""
SIZE = ".size"
"""Suffix of a pattern's column."""
UNMEASURED = ("sonar_temperature.rise", "floor_slope.x", "floor_slope.y", "exposure_variation.gamma")
"""Errors that pictures do not measure: a drifting scale, of which a segment has little; differences between
healthy places; and a variance that resembles another. Varying brightness is reported as that of the gain."""


def picture_effects() -> list[str]:
    """Return every error that pictures may show."""
    terms = [n for n in (*CAMERA, *SENSOR) if n.partition(".")[0] in CATALOGUE and n not in UNMEASURED]
    return [*terms, *LATE, *(name + SIZE for name in PATTERNS)]


def in_catalogue(column: str, size: float) -> float:
    """Return a column's size in the catalogue's unit: for a variance, the standard deviation."""
    if column in CAMERA:
        return catalogued(CAMERA.index(column), size)
    effect, _, parameter = column.rpartition(".")
    return size + CATALOGUE[effect].parameter(parameter).neutral


def is_square(column: str) -> bool:
    """Whether a column is a square, or a variance: its size cannot be negative."""
    if column in CAMERA:
        return CAMERA.index(column) in SQUARES
    return column.removesuffix(SIZE) in VARIANCE_PATTERNS
