"""A live map at the pace of the camera: pictures that are used, latency, and the map after the last one.

A camera hands decoded pictures: the recordings are decoded before they are played. At 640 x 480 a second row
plays PNG files, whose decoding takes a part of the cores.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from slam import simulate
from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.evaluation.live_error import live_error
from slam.io.flight_folder import read_flight
from slam.io.flight_writer import write_flight
from slam.mapping.live.arrival import replay_flight
from slam.mapping.live.mapper import LiveMapper
from slam.mapping.pipeline import optimize
from slam.simulation.recipe import load_recipe
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_least, at_most, reported

MOST_LATENCY_MS, MOST_WORSE = 150.0, 1.2
FAST = {"size_px": (640, 480), "rate_hz": 30.0}
SEED = 0


def measure() -> list[Metric]:
    """Fly the recorded AR.Drone at its 15 pictures a second, and the square at 640 x 480 and 30."""
    with tempfile.TemporaryDirectory() as name:
        fast = Path(name) / "fast"
        recipe = load_recipe("square")
        # A simulation renders its pictures when they are read: that would take the time of the map.
        write_flight(simulate(replace(recipe, camera=replace(recipe.camera, **FAST)), SEED), fast)
        return [
            *_flown("hybrid, 15 pictures/s", _decoded(read_flight(folder("flights/ardrone2-hybrid"))), 1.0),
            *_flown("640 x 480, 30 pictures/s", _decoded(read_flight(fast)), 0.9),
            *_flown("640 x 480, 30 pictures/s, from PNG files", read_flight(fast), None),
        ]


def _decoded(flight: Flight) -> Flight:
    """Return the flight with its pictures in memory."""
    assert flight.frames is not None
    pictures = [flight.frames.load(k) for k in range(len(flight.frames))]
    return replace(flight, frames=replace(flight.frames, load=pictures.__getitem__))


def _flown(title: str, flight: Flight, least_used: float | None) -> list[Metric]:
    """Fly at the pace of the stamps; ``least_used``: least share of pictures, None for no limits at all."""
    with LiveMapper(flight) as mapper:
        replay_flight(mapper, flight)
        mapper.close()
        state, (frames, w_T_b) = mapper.state(), mapper.keyframes()
        estimate = mapper.finish()
    pictures = len(flight.frames) if flight.frames is not None else 0
    late_ms, median_ms = 1e3 * np.percentile(state.latency_s, [95, 50])
    after, whole = evaluate(estimate, flight), evaluate(optimize(flight), flight)
    apart_m = live_error(frames, w_T_b, estimate)
    errors = f"{1e3 * after.ate_m.rmse:.2f} over {1e3 * whole.ate_m.rmse:.2f} mm"
    metrics = [
        at_least(
            f"{title}: share of pictures used", 1 - state.dropped / pictures, "", least_used or 0.0,
            f"{state.dropped} of {pictures} dropped",
        ),
        at_most(
            f"{title}: arrival to tracked, 95th percentile", late_ms, "ms", MOST_LATENCY_MS,
            f"median {median_ms:.0f} ms",
        ),
        at_most(
            f"{title}: position error after the last picture over the post-flight one",
            after.ate_m.rmse / whole.ate_m.rmse, "x", MOST_WORSE, errors,
        ),
        reported(f"{title}: live positions from the final ones, RMS", apart_m, "m"),
    ]  # fmt: skip
    limited = least_used is not None
    return metrics if limited else [reported(m.key, m.value, m.unit, m.source) for m in metrics]
