"""Kinds of simulated flights for `tests.benchmarks.instruments`.

In each flight all instruments have errors of their stated size: gain and zero of the sonar, gain and offset
of the accelerometer, offset of the gyro. A single draw of the gains would decide a flight, so gains and zero
are drawn in strata over the flights. Some kinds have a fault that no instrument states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import norm

from backend.measurements import GRAVITY_M_S2
from slam.core.flight import Flight
from slam.core.streams import Imu, Sonar
from slam.mapping.config import SensorTrust
from slam.simulation import simulate
from slam.simulation.recipe import Recipe, load_recipe, recipe_from

SEEDS = (0, 1)
CORNERS, FLOOR_M, HEIGHTS_M, LEAST_LEG_M = 7, (0.2, 2.8), (0.6, 1.1), 1.0
ACCEL_OFFSET_M_S2, GYRO_OFFSET_RAD_S = 0.2, 0.01
"""Standard deviations of the errors of cheap units at rest."""
LANE_M_S, LANE_HEIGHT_M, LANE_END_M = 0.8, 0.8, 2.0
"""Speed and height along a lane with a blank piece, and length of its textured ends."""
FOOTPRINT_M = 2 * LANE_HEIGHT_M * np.tan(np.radians(32)) * 144 / 176
"""Length of the picture's footprint along the lane."""
LEAPS, LEAP_S = 8, (0.3, 0.2, 0.3, 0.2)
"""Leaps of a violent flight, and how long each pushes, rests, brakes and rests."""

Alter = Callable[[Flight, np.random.Generator], Flight]


@dataclass(frozen=True)
class Kind:
    """A kind of flight: its recipe, and what happens to its recording."""

    name: str
    recipe: Callable[[np.random.Generator], Recipe]
    alter: Alter = lambda flight, rng: flight
    gap_s: float = 0.0
    """Time without texture below the camera."""


def flown(kind: Kind, seed: int) -> Flight:
    """Simulate one flight of a kind; its pictures are held in memory."""
    number = seed * len(KINDS) + list(KINDS).index(kind.name)
    rng = np.random.default_rng((number, 11))
    flight = simulate(kind.recipe(rng), seed)
    assert flight.frames is not None
    assert flight.imu is not None
    assert flight.sonar is not None
    pictures = [flight.frames.load(k) for k in range(len(flight.frames))]
    gain, zero, accel_gain = _strata(number, rng)
    flight = replace(
        flight,
        frames=replace(flight.frames, load=pictures.__getitem__),
        velocity=None,
        imu=_inertial(flight.imu, accel_gain, rng),
        sonar=_ranged(flight.sonar, gain, zero),
    )
    return kind.alter(flight, rng)


def _strata(number: int, rng: np.random.Generator) -> list[float]:
    """Return three standard normal numbers. Over the flights of two seeds each has one from every stratum, in
    independent orders. Further seeds have other orders: else each kind of flight would keep its errors."""
    flights = len(KINDS) * len(SEEDS)
    turn, place = divmod(number, flights)
    orders = np.random.default_rng(11 + turn).permuted(np.tile(np.arange(flights), (3, 1)), axis=1)
    share = (orders[:, place] + rng.uniform(size=3)) / flights
    return list(norm.ppf(share))


def _ranged(sonar: Sonar, gain: float, zero: float) -> Sonar:
    # The simulator's own zero is stated as exact.
    scale_std, datum_std_m = Sonar.scale_std, Sonar.datum_std_m
    range_m = (1 + scale_std * gain) * sonar.range_m + datum_std_m * zero
    return replace(sonar, range_m=range_m, scale_std=scale_std, datum_std_m=datum_std_m)


def _inertial(imu: Imu, gain: float, rng: np.random.Generator) -> Imu:
    gain = 1 + SensorTrust.accel_gain_std * gain
    return replace(
        imu,
        accel_m_s2=gain * imu.accel_m_s2 + rng.normal(0, ACCEL_OFFSET_M_S2, 3),
        gyro_rad_s=imu.gyro_rad_s + rng.normal(0, GYRO_OFFSET_RAD_S, 3),
    )


def corners(
    rng: np.random.Generator,
    floor_m: tuple[float, float] = FLOOR_M,
    maneuver: dict[str, Any] | None = None,
    **changes: Any,
) -> Recipe:
    """Return straight lines between random corners at changing heights, each corner a landmark.

    ``maneuver`` changes keys of that table of the recipe; ``changes`` adds tables or changes their keys.
    """

    def anywhere() -> tuple[float, float, float]:
        x, y = rng.uniform(*floor_m, 2).tolist()
        return x, y, float(rng.uniform(*HEIGHTS_M))

    points = [anywhere()]
    while len(points) < CORNERS:
        there = anywhere()
        if np.hypot(*np.subtract(there[:2], points[-1][:2])) > LEAST_LEG_M:
            points.append(there)
    tables: dict[str, Any] = {
        "maneuver": {"way_points": [*points, points[0]], "cruise_m_s": 0.8, "acceleration_m_s2": 1.5},
        "world": {
            "extent_m": [0, 0, floor_m[1] + 0.2, floor_m[1] + 0.2],
            "mark_diameter_m": 0.0,
            "seed": int(rng.integers(1000)),
        },
        "camera": {"size_px": [176, 144], "rate_hz": 10.0},
    }
    for name, keys in {"maneuver": maneuver or {}, **changes}.items():
        tables[name] = {**tables.get(name, {}), **keys}
    return _recipe({str(k): point[:2] for k, point in enumerate(points)}, tables)


def lane(rng: np.random.Generator, gap_s: float) -> Recipe:
    """Return a lane with a blank piece that the camera sees alone for ``gap_s``. A small triangle at either
    end shows how the vehicle moves before and after it."""
    blank_m = LANE_M_S * gap_s + FOOTPRINT_M
    far_m = LANE_END_M + blank_m
    near = [(0.4, 0.4), (1.4, 0.6), (0.6, 1.4)]
    there = [(far_m + 1.6, 1.0), (far_m + 0.8, 0.3), (far_m + 0.8, 1.5)]
    heights_m = rng.uniform(0.9, 1.1, 7) * LANE_HEIGHT_M
    heights_m[3:5] = LANE_HEIGHT_M
    points = [(*p, float(h)) for p, h in zip([*near, (0.4, 1.0), *there], heights_m, strict=True)]
    tables = {
        "maneuver": {"way_points": points, "cruise_m_s": LANE_M_S, "acceleration_m_s2": 1.5},
        "world": {
            "extent_m": [0, 0, far_m + LANE_END_M, 1.9],
            "mark_diameter_m": 0.0,
            "blanks_m": [[LANE_END_M, -1.0, far_m, 2.9]],
            "seed": int(rng.integers(1000)),
        },
        "camera": {"size_px": [176, 144], "rate_hz": 10.0},
    }
    return _recipe({str(k): point[:2] for k, point in enumerate(points)}, tables)


def _recipe(landmarks: dict[str, Any], tables: dict[str, Any]) -> Recipe:
    names = list(landmarks)
    return recipe_from(
        {
            "name": "instruments",
            "landmarks": landmarks,
            "landmark_pairs": [list(pair) for pair in pairwise(names)],
            **tables,
        },
        "instruments",
    )


def _court(rng: np.random.Generator) -> Recipe:
    recipe = load_recipe("court_eight")
    return replace(recipe, world=replace(recipe.world, seed=int(rng.integers(1000))))


def _violent(rng: np.random.Generator) -> Recipe:
    """Return leaps in all directions at full stick, and the same way back: tilts of 30 degrees, 300 deg/s."""
    leaps = [(np.cos(a), np.sin(a), up) for a, up in zip(*_leaps(rng), strict=True)]
    leaps += [(-x, -y, -up) for x, y, up in reversed(leaps)]
    rows: list[tuple[float, ...]] = []
    for x, y, up in leaps:
        for part, sign in enumerate((1, 0, -1, 0)):  # the pauses keep the turn below 60 degrees at once
            begin_ms = 1000.0 * (len(rows) // 4 * sum(LEAP_S) + sum(LEAP_S[:part]))
            rows.append((begin_ms, sign * x, sign * y, up, 0.0))
    rows.append((1000.0 * len(leaps) * sum(LEAP_S), 0.0, 0.0, 0.0, 0.0))
    tables = {
        "maneuver": {"script": rows, "height_m": 1.2, "rest_s": 1.0},
        "world": {
            "extent_m": [-4, -4, 4, 4],
            "margin_m": 2.5,
            "metres_per_px": 0.004,
            "mark_diameter_m": 0.0,
            "seed": int(rng.integers(1000)),
        },
        "camera": {"size_px": [176, 144], "rate_hz": 30.0},
    }
    return _recipe({"S": (0.0, 0.0), "E": (0.3, 0.3)}, tables)


def _leaps(rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Return the headings of the leaps, each at least 60 degrees from the one before, and their climbs."""
    headings = rng.uniform(-np.pi, np.pi) + np.cumsum(rng.uniform(np.pi / 3, np.pi, LEAPS))
    return headings.tolist(), rng.uniform(-0.15, 0.15, LEAPS).tolist()


def _windy(rng: np.random.Generator) -> Recipe:
    x, y = rng.normal(0, 1.0, 2).tolist()
    return corners(rng, terms={"steady_wind": {"x": x, "y": y}, "gusts": {"sigma": 0.4, "tau": 1.5}})


def _bias_jump(flight: Flight, rng: np.random.Generator) -> Flight:
    """Both sensors of the IMU change their offset at once, in the middle of the flight."""
    imu = flight.imu
    assert imu is not None
    after = (imu.stamps_s > np.mean(imu.stamps_s))[:, None]
    return replace(
        flight,
        imu=replace(
            imu,
            accel_m_s2=imu.accel_m_s2 + after * rng.choice([-0.8, 0.8], 3),
            gyro_rad_s=imu.gyro_rad_s + after * rng.choice([-0.05, 0.05], 3),
        ),
    )


def _saturated(flight: Flight, rng: np.random.Generator) -> Flight:
    """The IMU's ranges are exceeded in the sharpest twentieth of the flight."""
    imu = flight.imu
    assert imu is not None
    at_rest = np.array([0.0, 0.0, GRAVITY_M_S2])
    accel, gyro = imu.accel_m_s2 - at_rest, imu.gyro_rad_s
    most_accel, most_gyro = (np.quantile(np.abs(values), 0.95) for values in (accel, gyro))
    clipped = np.clip(accel, -most_accel, most_accel) + at_rest
    imu = replace(imu, accel_m_s2=clipped, gyro_rad_s=np.clip(gyro, -most_gyro, most_gyro))
    return replace(flight, imu=imu)


def _late_imu(flight: Flight, rng: np.random.Generator) -> Flight:
    """The IMU's clock is off by up to 0.1 s, and runs up to 200 ppm fast or slow."""
    late_s, drift = rng.choice([-1, 1]) * rng.uniform(0.04, 0.1), rng.uniform(-2e-4, 2e-4)
    return flight.restamped(["imu"], lambda stamps_s: stamps_s * (1 + drift) + late_s)


def _without_sonar(flight: Flight, rng: np.random.Generator) -> Flight:
    return replace(flight, sonar=None)


_ALL = (
    Kind("rich floor", corners),
    *(
        Kind(f"gap of {gap_s} s", lambda rng, gap_s=gap_s: lane(rng, gap_s), gap_s=gap_s)
        for gap_s in (1, 2, 5)
    ),
    Kind("floor of lines", _court),
    Kind("3 pictures a second", lambda rng: corners(rng, camera={"rate_hz": 3.0})),
    Kind("violent", _violent),
    Kind("no sonar", corners, _without_sonar),
    Kind("biased sonar", lambda rng: corners(rng, terms={"sonar_bias": {"b": 0.05}})),
    Kind("wind", _windy),
    Kind("IMU with jumping biases", corners, _bias_jump),
    Kind("saturated IMU", corners, _saturated),
    Kind("IMU with a wrong clock", corners, _late_imu),
)
KINDS = {kind.name: kind for kind in _ALL}
