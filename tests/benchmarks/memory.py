"""Peak memory and time of a flight ten times as long: the figure eight flown once, and ten times over.

Every job has a process of its own, since a process never gives back its peak. The long flight is taken at
176x144 and 6 pictures a second, so that it fits a few minutes.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from slam.mosaic import write_mosaic
from slam.pipeline import optimize
from slam.simulation import simulate
from slam.simulation.recipe import Recipe, load_recipe
from tests.benchmarks.apart import peak_mb, run_apart
from tests.benchmarks.metric import Metric, at_most, told

_ME = "tests.benchmarks.memory"

LAPS = 10
SIZE_PX, RATE_HZ = (176, 144), 6.0


@dataclass(frozen=True)
class Job:
    """What one process needed."""

    frames: int
    keyframes: int
    seconds: float
    peak_mb: float


def measure() -> list[Metric]:
    """Ten laps against one, without and with the mosaic."""
    metrics = []
    with tempfile.TemporaryDirectory() as scratch:
        flights = {laps: Path(scratch) / f"{laps}-laps" for laps in (1, LAPS)}
        for laps, path in flights.items():
            run_apart(_ME, "fly", laps, path)
        for work in ("map", "map-and-mosaic"):
            short, long = (Job(**run_apart(_ME, work, laps, path)) for laps, path in flights.items())
            name = "without mosaic" if work == "map" else "with mosaic"
            metrics += [
                at_most(f"peak memory, {LAPS} laps over 1, {name}", long.peak_mb / short.peak_mb, "x", 1.3),
                told(f"peak memory, 1 lap, {name}", short.peak_mb, "MB", _told(short)),
                told(f"peak memory, {LAPS} laps, {name}", long.peak_mb, "MB", _told(long)),
                told(f"time, {LAPS} laps over 1, {name}", long.seconds / short.seconds, "x"),
            ]
    return metrics


def _told(job: Job) -> str:
    return f"{job.frames} pictures, {job.keyframes} keyframes, {job.seconds:.0f} s"


def recipe(laps: int) -> Recipe:
    """The shipped figure eight, flown ``laps`` times with a small camera."""
    eight = load_recipe("figure_eight")
    return replace(
        eight,
        maneuver=replace(eight.maneuver, laps=laps),
        camera=replace(eight.camera, size_px=SIZE_PX, rate_hz=RATE_HZ),
    )


def fly(laps: int, path: Path) -> None:
    """Write the flight: its simulator's floor must not count as the mapper's memory."""
    write_flight(simulate(recipe(laps)), path)


def run(path: Path, mosaic: bool) -> Job:
    """Map a written flight in this process."""
    began = time.perf_counter()
    flight = read_flight(path)
    assert flight.frames is not None
    estimate = optimize(flight)
    if mosaic:
        write_mosaic(estimate, flight, path.with_name(f"{path.name}-mosaic"))
    return Job(len(flight.frames), len(estimate.stamps_s), time.perf_counter() - began, peak_mb())


def main(work: str, laps: int, path: Path) -> None:
    """One job, told as JSON."""
    if work == "fly":
        fly(laps, path)
    print(json.dumps(None if work == "fly" else asdict(run(path, mosaic=work == "map-and-mosaic"))))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
