"""Writes ``map.html`` from an estimate and the rasters of its output folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.core.messages import by_kind
from slam.core.units import unit
from slam.core.version import VERSION
from slam.report.answers.advice import limit_sentence
from slam.report.answers.headline import sentence
from slam.report.facts import Facts
from slam.report.map_page.features import floor_points, keyframes, links, surveyed_points
from slam.report.map_page.rasters import read_images, tile_set, value_grid
from slam.report.mosaic_facts import mosaic_facts
from slam.report.page import render_page

MAP_PAGE = "map.html"
_IMAGES = {"map": "mosaic.png", "chain": "mosaic_chain.png"}
_VALUES = {"elevation": ("elevation.tif", 1), "sigma": ("mosaic_quality.tif", 2)}
"""Layer -> file of values and band."""
_COLOUR_STOPS = 17
"""Colours of viridis between which the page interpolates, to less than a step of 8 bits."""


def write_map_page(
    folder: Path, estimate: Estimate, flight: Flight | None, facts: Facts, status: str
) -> Path | None:
    """Write the page into the output ``folder``, whose rasters it shows; return None if nothing is placed.

    ``flight`` is None where the input was a graph.
    """
    if facts.placed == 0:
        return None
    ground = mosaic_facts(folder / _IMAGES["map"], folder / _VALUES["sigma"][0], facts.gaps)
    data = {
        "metric": facts.metric,
        "unit": unit(facts.metric),
        "onEarth": estimate.origin is not None,
        "scaleStd": _known(estimate.scale_std),
        "middleStd": _known(estimate.middle_std_m),
        "lengthStds": [row for row in estimate.length_stds if np.isfinite(row).all()],
        "keyframes": keyframes(estimate, flight, facts.gaps),
        "links": links(estimate),
        "points": floor_points(estimate),
        "surveyed": surveyed_points(estimate.control),
        "tiles": _tiles(folder),
        "grids": _grids(folder),
        "colours": _colours(),
    }
    page = render_page(
        "map_page/page.html.j2",
        name=estimate.name,
        version=VERSION,
        sentence=sentence(facts, status, ground),
        limit=limit_sentence(estimate.information_shares, facts.metric, ground is not None),
        reasons=[message.sentences for message in by_kind(estimate.messages).reasons],
        is_graph=facts.is_graph,
        data=_in_script(data),
    )
    path = folder / MAP_PAGE
    path.write_text(page, encoding="utf-8", errors="replace")
    return path


def _known(std: float | None) -> float:
    """Return a standard deviation, 0 where it is not known: the page then counts that of the points alone."""
    return std if std is not None and np.isfinite(std) else 0.0


def _tiles(folder: Path) -> dict[str, Any] | None:
    paths = {layer: folder / name for layer, name in _IMAGES.items() if (folder / name).exists()}
    return tile_set(read_images(paths)).to_json() if paths else None


def _grids(folder: Path) -> dict[str, Any]:
    found = {
        layer: value_grid(folder / name, band)
        for layer, (name, band) in _VALUES.items()
        if (folder / name).exists()
    }
    return {layer: grid for layer, grid in found.items() if grid is not None}


def _colours() -> list[list[int]]:
    import matplotlib

    return [
        [round(255 * share) for share in matplotlib.colormaps["viridis"](x)[:3]]
        for x in np.linspace(0, 1, _COLOUR_STOPS)
    ]


def _in_script(data: dict[str, Any]) -> Markup:
    """Return JSON that cannot end the script element that holds it."""
    return Markup(json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))
