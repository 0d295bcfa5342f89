"""Faults 45 to 49: what the pictures show, and graphs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from frontend.features import Features
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.points import Points
from frontend.registration import register
from slam.core.flight import Flight
from slam.io.flight_folder import write_flight
from tests.frontend.floor_pairs import CAMERA
from tests.slam.faults.fault import Event, Fault, Sources, optimized
from tests.slam.faults.made_graph import edited, laps
from tests.slam.small_flight import flown, seeing


def mapped(made: Callable[[], Flight]) -> Callable[[Sources, Path], str]:
    """The map of a flight, and what its summary says."""

    def play(_: Sources, place: Path) -> str:
        write_flight(made(), place / "flight")
        return optimized(place / "flight", place / "out")

    return play


def short(**tables: dict[str, Any]) -> Flight:
    small = {"way_points": ["A", "B"], "cruise_m_s": 0.5}
    return flown(maneuver=small | tables.pop("maneuver", {}), **({"camera": {"rate_hz": 4.0}} | tables))


def hovering() -> Flight:
    return short(maneuver={"way_points": ["A", "A"], "rest_s": 3.0})


def turning() -> Flight:
    """A turn on the spot: no baseline."""
    rows = [[0, 0, 0, 0, 0], [500, 0, 0, 0, 0.4], [3500, 0, 0, 0, 0]]
    return short(maneuver={"script": rows, "start_m": [0.8, 0.5], "way_points": []})


def sloping() -> Flight:
    return short(world={"slope": [0.2, 0.1]})


def partly_plain() -> Flight:
    """Some pictures show nothing."""
    flight = short()
    frames = flight.frames
    assert frames is not None
    return seeing(flight, lambda k: 0 * frames.load(k) + 90 if k in (4, 5) else frames.load(k))


def frozen() -> Flight:
    """The camera repeats one picture in the middle."""
    flight = short()
    frames = flight.frames
    assert frames is not None
    return seeing(flight, lambda k: frames.load(5 if 5 <= k < 8 else k))


def registered(pixel_i: np.ndarray, pixel_j: np.ndarray) -> Callable[[Sources, Path], str]:
    """The reason for which two pictures with these matches are not registered."""

    def play(_: Sources, place: Path) -> str:
        def features(pixel: np.ndarray) -> Features:
            descriptor = 100 * np.eye(len(pixel), 128, dtype=np.float32)
            return Features(Points(np.asarray(pixel, float), np.ones(len(pixel))), descriptor)

        found = register(0, 1, features(pixel_i), features(pixel_j), CAMERA, HomographyConfig(), GateConfig())
        return str(found.reason)

    return play


def half_false(_: Sources, place: Path) -> str:
    """Half of the loops join places that only look alike: the error stays within that of the odometry."""
    truth = laps(place / "laps.g2o", false=20)
    message = optimized(place / "laps.g2o", place / "out")
    xyz = np.loadtxt(place / "out" / "trajectory.tum")[:, 1:4]
    error_m = float(np.linalg.norm(xyz[:, :2] - truth[:, :2], axis=1).max())
    laps(place / "bare.g2o", every=1000)
    optimized(place / "bare.g2o", place / "bare")
    bare = np.loadtxt(place / "bare" / "trajectory.tum")[:, 1:4]
    drift_m = float(np.linalg.norm(bare[:, :2] - truth[:, :2], axis=1).max())
    assert error_m < drift_m + 1e-6, (error_m, drift_m)
    return message


def large(_: Sources, place: Path) -> str:
    laps(place / "laps.g2o", count=100_000, per_lap=2000)
    return optimized(place / "laps.g2o", place / "out")


def two_parts(lines: list[str]) -> list[str]:
    """Without any edge between the first lap and the others."""

    def part(vertex: str) -> bool:
        return int(vertex) < 40

    return [line for line in lines if len({part(v) for v in line.split()[1:3]}) == 1]


RNG = np.random.default_rng(4)
SPREAD = RNG.uniform([0, 0], CAMERA.size_px, (60, 2))
SHUFFLED = RNG.permutation(SPREAD)
LINE = np.linspace([10, 20], [150, 110], 60)
FAULTS = (
    Event(45, "some pictures without features", "W", "too few features", mapped(partly_plain), is_slow=True),
    Event(45, "frozen camera", "W", "same picture as the one before", mapped(frozen), is_slow=True),
    Event(45, "hover", "W", "one place only", mapped(hovering), is_slow=True),
    Event(46, "collinear points", "W", ".", registered(LINE, LINE + 5)),
    Event(46, "identical points", "W", ".", registered(np.full((60, 2), 50.0), np.full((60, 2), 60.0))),
    Event(46, "three points", "W", "too few matches", registered(SPREAD[:3], SPREAD[:3] + 5)),
    Event(46, "random matches", "W", ".", registered(SPREAD, SHUFFLED)),
    Event(47, "pure rotation", "W", "one place only", mapped(turning), is_slow=True),
    Event(47, "sloping ground", "W", "slope|tilted|sky|lean", mapped(sloping), is_slow=True),
    Event(
        48,
        "half the loops false",
        "W",
        '"edge disagrees with the rest of the graph": ',
        half_false,
        is_slow=True,
    ),
    Fault(49, "disconnected graph", "W", "2 parts", edited(two_parts), "optimize", "graph"),
    Fault(49, "graph held nowhere", "W", '"status": ', edited(lambda t: t), "optimize", "graph"),
    Event(49, "graph of 100 000 poses", "W", '"keyframes": 100000', large, is_slow=True),
)  # fmt: skip
