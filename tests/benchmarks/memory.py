"""Peak memory and time of a flight ten times as long: one and ten laps of the figure eight.

Both are written to disk first, and each is mapped in a separate process, since a process does not return its
peak. They have 3 pictures of 176x144 a second, so the long one takes a few minutes.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from slam.mapping.pipeline import optimize
from slam.report.rasters.mosaic import write_mosaic
from slam.simulation import simulate
from slam.simulation.recipe import Recipe, load_recipe
from tests.benchmarks.apart import Took, run_apart, timed
from tests.benchmarks.metric import Metric, at_most, reported

_ME = "tests.benchmarks.memory"

LAPS = 10
SIZE_PX, RATE_HZ = (176, 144), 3.0


@dataclass(frozen=True)
class Job:
    """Time and memory of one process."""

    frames: int
    keyframes: int
    mapping: Took
    mosaic: Took


def measure() -> list[Metric]:
    """Return ten laps against one, without and with the mosaic."""
    with tempfile.TemporaryDirectory() as scratch:
        short, long = (fly_and_map(laps, Path(scratch) / f"{laps}-laps") for laps in (1, LAPS))
    return [
        ratio("peak memory, without mosaic", short.mapping.peak_mb, long.mapping.peak_mb, "MB", 1.3),
        ratio("peak memory, with mosaic", short.mosaic.peak_mb, long.mosaic.peak_mb, "MB", 1.3),
        ratio("time to the map", short.mapping.seconds, long.mapping.seconds, "s", None),
        ratio("time of the mosaic", short.mosaic.seconds, long.mosaic.seconds, "s", None),
        ratio("pictures", short.frames, long.frames, "", None),
        ratio("keyframes", short.keyframes, long.keyframes, "", None),
    ]


def ratio(what: str, short: float, long: float, unit: str, limit: float | None) -> Metric:
    """Return the ratio of ten laps to one."""
    key, source = f"{what}, {LAPS} laps over 1", f"{long:.0f} over {short:.0f} {unit}".strip()
    value = long / short
    return reported(key, value, "x", source) if limit is None else at_most(key, value, "x", limit, source)


def fly_and_map(laps: int, path: Path) -> Job:
    """Run two processes, since the simulator's floor must not count as the mapper's memory."""
    run_apart(_ME, "fly", laps, path)
    found = run_apart(_ME, "map", laps, path)
    mapping, mosaic = Took(**found.pop("mapping")), Took(**found.pop("mosaic"))
    return Job(**found, mapping=mapping, mosaic=mosaic)


def recipe(laps: int) -> Recipe:
    """Simulate ``laps`` laps of the figure eight with a small camera."""
    eight = load_recipe("figure_eight")
    return replace(
        eight,
        maneuver=replace(eight.maneuver, laps=laps),
        camera=replace(eight.camera, size_px=SIZE_PX, rate_hz=RATE_HZ),
    )


def run(path: Path) -> Job:
    """Map a written flight in this process."""
    with timed() as mapping:
        flight = read_flight(path)
        estimate = optimize(flight)
    with timed() as drawing:
        write_mosaic(estimate, flight, path.with_name(f"{path.name}-mosaic"))
    assert flight.frames is not None
    return Job(len(flight.frames), len(estimate.stamps_s), mapping[0], drawing[0])


def main(work: str, laps: int, path: Path) -> None:
    """Run one process: ``fly`` writes the flight, ``map`` prints time and memory of mapping it."""
    if work == "fly":
        write_flight(simulate(recipe(laps)), path)
    print(json.dumps(asdict(run(path)) if work == "map" else None))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
