"""The interactive map in a browser: its size, and the time until it is seen."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from slam.cli.demo import DEMO_RECIPE
from slam.cli.results import MosaicOptions, write_results
from slam.core.progress import silent
from slam.mapping.pipeline import optimize
from slam.report.map_page.write import MAP_PAGE
from slam.simulation import simulate
from tests.benchmarks.metric import Metric, Skipped, at_most, reported
from tests.slam.report.map_page.browser import BROWSER, paint_times
from tests.slam.report.map_page.largest_page import largest_page

REPEATS = 5
DEMO_MB, LARGEST_MB, FIRST_PAINT_S = 3.0, 25.0, 2.0


def measure() -> list[Metric]:
    """Return the figures of the demo's page and of the largest one that any flight makes."""
    if BROWSER is None:
        raise Skipped("Chromium is not installed")
    return [*_opened("demo", _demo, DEMO_MB), *_opened("largest page", largest_page, LARGEST_MB)]


def _demo(folder: Path) -> Path:
    flight = simulate(DEMO_RECIPE, 0)
    write_results(folder, optimize(flight), flight, MosaicOptions(), silent)
    return folder / MAP_PAGE


def _opened(name: str, written: Callable[[Path], Path], most_mb: float) -> list[Metric]:
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder))
        size_mb = path.stat().st_size / 1e6
        times = [paint_times(path) for _ in range(REPEATS)]
    contentful = [each.contentful_s for each in times]
    source = f"PerformancePaintTiming in headless Chromium, {REPEATS} times"
    return [
        at_most(f"{name}: size of map.html", size_mb, "MB", most_mb),
        reported(f"{name}: first contentful paint, median", float(np.median(contentful)), "s", source),
        at_most(f"{name}: first contentful paint, largest", max(contentful), "s", FIRST_PAINT_S, source),
        reported(
            f"{name}: pictures of the map drawn, median", float(np.median([t.shown_s for t in times])), "s"
        ),
    ]
