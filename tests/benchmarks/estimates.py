"""``slam estimate`` on measured flights without a camera, compared with motion capture and GPS."""

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
"""Time of the outdoor flight whose GPS is used, in seconds; the rest of it is the reference."""


def measure() -> list[Metric]:
    """Return the error of the smoothed path over that of the on-board dead reckoning."""
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
    """Return the horizontal RMS distance of a path (n, 3) to the reference."""
    return _rms((way_m - tracks.reference_m)[:, :2])


def drift_m(tracks: Tracks, way_m: Array) -> float:
    """Return the same for the drift of a path (n, 3) from the reference after ``GPS_FOR_S``."""
    later = tracks.stamps_s > GPS_FOR_S
    off = (way_m - tracks.reference_m)[later, :2]
    return _rms(off - off[0])


def _rms(off: Array) -> float:
    return float(np.sqrt(np.nanmean(np.sum(off**2, axis=1))))


def with_early_gps(flight: Flight) -> Tracks:
    """Return the paths with the first fixes only, and with all."""
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
