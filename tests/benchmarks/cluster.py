"""Photographs mapped by processes of Dask against threads: the same bits, and the time of the shared stages.

``python -m tests.benchmarks.cluster 16`` prints the figures of the last 16 photographs alone.
"""

from __future__ import annotations

import sys
import tempfile
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from frontend.workers import Workers, share_with, workers
from slam.core.flight import Flight
from slam.io.photos.import_photos import import_photos
from slam.mapping.pipeline import optimize
from slam.parallel.cluster import cluster
from slam.report.rasters.mosaic import write_chain_picture
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, reported
from tests.slam.small_flight import only


@dataclass(frozen=True)
class Run:
    """One map."""

    bits: bytes
    photographs_s: float
    """Time to read, search and register the photographs in their order."""
    pairs_s: float
    mosaic_s: float
    """Time of a mosaic over the floor: exposure, tiles and files."""

    @property
    def seconds(self) -> float:
        return self.photographs_s + self.pairs_s + self.mosaic_s


def measure(count: int | None = None) -> list[Metric]:
    """Map the last ``count`` photographs of `caliterra`, or all, with one and two workers of each kind."""
    flight = import_photos(folder("photos/caliterra"))
    frames = flight.frames
    assert frames is not None
    flight = flight if count is None else only(flight, range(len(frames) - count, len(frames)))
    runs = {
        (kind, number): mapped(flight, chosen(number))
        for number in (2, 1)
        for kind, chosen in (("threads", threads), ("Dask", processes))
    }
    threaded, dask = runs["threads", 2], runs["Dask", 2]
    parts = "photographs, pairs and mosaic; workers that run already"
    metrics = [
        at_least("maps with the same bits, of 4", sum(r.bits == dask.bits for r in runs.values()), "", 4),
        at_least(
            "speed of two workers of Dask over two threads", threaded.seconds / dask.seconds, "x", 0.85, parts
        ),
    ]
    for kind in ("threads", "Dask"):
        one, two = runs[kind, 1], runs[kind, 2]
        key, ratio = f"photographs, one worker to two, {kind}", one.photographs_s / two.photographs_s
        source = f"{one.photographs_s:.1f} s to {two.photographs_s:.1f} s"
        metrics.append(at_least(key, ratio, "x", 1.8, source))
        metrics += [
            reported(f"{name}, two workers, {kind}", seconds, "s")
            for name, seconds in (("pairs", two.pairs_s), ("mosaic", two.mosaic_s))
        ]
    return metrics


def threads(count: int) -> AbstractContextManager[Any]:
    """Return threads of this process as the workers of a block."""
    return share_with(Workers(count))


def processes(count: int) -> AbstractContextManager[Any]:
    """Return processes of Dask as the workers of a block."""
    return cluster(count=count)


def mapped(flight: Flight, chosen: AbstractContextManager[Any]) -> Run:
    """Map the flight with the chosen workers, once all of them run."""
    with tempfile.TemporaryDirectory() as name, chosen:
        share = workers()
        while len(set(share.map(awake, None, range(2 * share.count)))) < share.count:
            pass
        estimate = optimize(flight)
        begin = time.perf_counter()
        mosaic = write_chain_picture(estimate, flight, Path(name), estimate.over_floor_T_b)
        mosaic_s = time.perf_counter() - begin
        bits = estimate.w_T_b.tobytes() + estimate.covariances.tobytes() + mosaic.read_bytes()
        return Run(bits, estimate.timing_s["track"], estimate.timing_s["loops"], mosaic_s)


def awake(shared: None, item: int) -> tuple[int, int]:
    """Return which process and thread does this job, after the libraries of a map are loaded."""
    import os
    import threading

    import frontend.mosaic.render  # noqa: F401

    time.sleep(0.2)
    return os.getpid(), threading.get_ident()


if __name__ == "__main__":
    for metric in measure(int(sys.argv[1])):
        print(metric)
