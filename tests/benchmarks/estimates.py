"""``slam estimate`` on measured flights without a camera: against motion capture, and against GPS."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.evaluation import evaluate
from slam.evaluation.score import Tracks
from slam.flight import Flight
from slam.inertial.navigate import navigate
from slam.io.flight_folder import read_flight
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most, told

GPS_FOR_S = 300.0
"""Of the flight outdoors so much of the GPS is used where the rest is what the way is held against."""


def measure() -> list[Metric]:
    """How far the smoothed way is from the reference, over dead reckoning on board."""
    indoors, outdoors = (
        read_flight(folder(f"flights/{name}")) for name in ("ardrone2-optitrack", "px4flow-quad")
    )
    return [
        *_compared("ardrone2-optitrack", "motion capture", _tracks(indoors)),
        *_compared("px4flow-quad", "its GPS", _tracks(outdoors)),
        *_compared(
            f"px4flow-quad, GPS of the first {GPS_FOR_S:.0f} s alone", "the rest of it",
            with_early_gps(outdoors), from_s=GPS_FOR_S,
        ),
    ]  # fmt: skip


def off_m(tracks: Tracks, way_m: NDArray[np.float64], from_s: float = 0.0) -> float:
    """Horizontal RMS distance of a way (n, 3) to the reference; from a later time on of how it drifts from
    where it was then."""
    off = (way_m - tracks.reference_m)[:, :2]
    if from_s > 0:
        later = tracks.stamps_s > from_s
        off = off[later] - off[int(np.argmax(later))]
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=1))))


def with_early_gps(flight: Flight) -> Tracks:
    """The ways where only the first fixes are used, beside all of them."""
    assert flight.gps is not None
    early = flight.gps.stamps_s < GPS_FOR_S
    gps = replace(
        flight.gps,
        stamps_s=flight.gps.stamps_s[early],
        latitude_deg=flight.gps.latitude_deg[early],
        longitude_deg=flight.gps.longitude_deg[early],
        altitude_m=flight.gps.altitude_m[early],
    )
    return evaluate(navigate(replace(flight, gps=gps)).estimate, flight).tracks


def _tracks(flight: Flight) -> Tracks:
    return evaluate(navigate(flight).estimate, flight).tracks


def _compared(name: str, reference: str, tracks: Tracks, from_s: float = 0.0) -> list[Metric]:
    ours, reckoned = (off_m(tracks, way, from_s) for way in (tracks.loops_m, tracks.chain_m))
    return [
        told(f"{name}: horizontally from {reference}", ours, "m"),
        told(f"{name}: the same of dead reckoning on board", reckoned, "m"),
        at_most(f"{name}: our error over dead reckoning's", ours / reckoned, "x", 1.0),
    ]
