"""Misregistration of the mosaics of photographs, over a flat floor and over the measured surface."""

from __future__ import annotations

import tempfile

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.misregistration import SQUARE_PX, Misregistration
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, at_most, reported

MOST_FILLED = 0.5
"""Share of a square from which on no height of it was measured for the most part, as of crowns of trees."""


def measure() -> list[Metric]:
    """Return the figures of two sets of photographs."""
    return [*photographs("isfm"), *photographs("caliterra")]


def photographs(name: str) -> list[Metric]:
    """Return the misregistration of a set of photographs, over a floor and over the surface."""
    flight = import_photos(folder(f"photos/{name}"))
    with tempfile.TemporaryDirectory() as out:
        made = write_mosaic(optimize(flight), flight, out)
    facts = made.ground.facts
    before, after = facts.over_floor_px[1], facts.misregistration_px[1]
    assert made.ground.over_surface is not None, f"{name} is not flat"
    found = made.ground.over_surface.found, made.ground.over_floor.found
    surface, over = made.ground.surface, made.ground.over_surface
    assert surface is not None
    matched = filled_share(surface, over, SQUARE_PX * made.gsd_m) <= MOST_FILLED
    matched_px = np.linalg.norm(over.shift_px[over.found & matched], axis=1)
    shares = f"found in {found[0].mean():.0%} of the squares, over a floor in {found[1].mean():.0%}"
    return [
        reported(f"{name}: misregistration, median, over a floor", facts.over_floor_px[0], "px"),
        reported(f"{name}: misregistration, median, over the surface", facts.misregistration_px[0], "px"),
        reported(f"{name}: misregistration, 95 %, over a floor", before, "px"),
        at_most(f"{name}: misregistration, 95 %, over the surface", after, "px", 1.5, shares),
        reported(
            f"{name}: the same where the ground was matched",
            float(np.percentile(matched_px, 95)),
            "px",
            f"in {len(matched_px) / over.found.sum():.0%} of the squares found",
        ),
        at_least(f"{name}: 95 % over a floor over that over the surface", before / after, "x", 4.0),
    ]


def filled_share(surface: Surface, measured: Misregistration, side_m: float) -> NDArray[np.float64]:
    """Return (n,) the share of each square whose height was not matched but filled."""
    cells, filled = side_m / surface.cell_m, surface.source == HeightSource.FILLED
    corners = [
        [slice(round(i * cells), round((i + 1) * cells)) for i in square] for square in measured.square
    ]
    return np.array([filled[rows, cols].mean() for rows, cols in corners])
