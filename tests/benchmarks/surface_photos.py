"""Misregistration of the mosaics of photographs, over a flat floor and over the measured surface."""

from __future__ import annotations

import tempfile

from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, at_most, reported


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
    shares = f"found in {found[0].mean():.0%} of the squares, over a floor in {found[1].mean():.0%}"
    return [
        reported(f"{name}: misregistration, median, over a floor", facts.over_floor_px[0], "px"),
        reported(f"{name}: misregistration, median, over the surface", facts.misregistration_px[0], "px"),
        reported(f"{name}: misregistration, 95 %, over a floor", before, "px"),
        at_most(f"{name}: misregistration, 95 %, over the surface", after, "px", 1.5, shares),
        at_least(f"{name}: 95 % over a floor over that over the surface", before / after, "x", 4.0),
    ]
