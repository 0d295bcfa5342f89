"""``slam estimate`` on measured flights without a camera: against motion capture, and against GPS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam.core.flight import Flight
from slam.evaluation import evaluate
from slam.evaluation.score import Tracks
from slam.inertial.navigate import navigate
from slam.io.flight_folder import read_flight
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most, reported

Array = NDArray[np.float64]

GPS_FOR_S = 300.0
"""Of the flight outdoors so much of the GPS is used where the rest is what the way is held against."""


def measure() -> list[Metric]:
    """How far the smoothed way is from the reference, over dead reckoning on board."""
    indoors, outdoors = (
        read_flight(folder(f"flights/{name}")) for name in ("ardrone2-optitrack", "px4flow-quad")
    )
    return [
        *_compared("ardrone2-optitrack", "motion capture", _tracks(indoors), off_m),
        *_compared("px4flow-quad", "its GPS", _tracks(outdoors), off_m),
        *_compared(
            f"px4flow-quad, GPS of the first {GPS_FOR_S:.0f} s alone", "the rest of it",
            with_early_gps(outdoors), drift_m,
        ),
    ]  # fmt: skip


def off_m(tracks: Tracks, way_m: Array) -> float:
    """Horizontal RMS distance of a way (n, 3) to the reference."""
    return _rms((way_m - tracks.reference_m)[:, :2])


def drift_m(tracks: Tracks, way_m: Array) -> float:
    """The same of how a way (n, 3) moves away from the reference once ``GPS_FOR_S`` are over."""
    later = tracks.stamps_s > GPS_FOR_S
    off = (way_m - tracks.reference_m)[later, :2]
    return _rms(off - off[0])


def _rms(off: Array) -> float:
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


def _compared(
    name: str, reference: str, tracks: Tracks, error_m: Callable[[Tracks, Array], float]
) -> list[Metric]:
    ours, reckoned = (error_m(tracks, way) for way in (tracks.loops_m, tracks.chain_m))
    return [
        reported(f"{name}: horizontally from {reference}", ours, "m"),
        reported(f"{name}: the same of dead reckoning on board", reckoned, "m"),
        at_most(f"{name}: our error over dead reckoning's", ours / reckoned, "x", 1.0),
    ]
