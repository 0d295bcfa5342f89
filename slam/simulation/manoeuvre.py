"""Manoeuvres: a smooth path of position and heading through way points.

A manoeuvre may also be a script of stick commands (``slam.simulation.script``). The vehicle flies straight
legs at cruising speed. At each way point its velocity changes from one leg to the next by a smooth step in
time. So position, velocity, acceleration and jerk are continuous, and no corner exceeds the acceleration
limit. The same step turns the heading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import BPoly

from slam.core.errors import InputError

Array = NDArray[np.float64]

WayPoint = str | tuple[float, float] | tuple[float, float, float]
Row = Annotated[tuple[float, ...], Field(min_length=5, max_length=5)]
"""A row of a script: milliseconds since the start, forward, left, up, yaw."""

STEP_PEAK_RATE = 35 / 16
"""Largest slope of the septic smooth step from 0 to 1 in unit time, used for the heading."""
STEP_PEAK_ACCELERATION = 15 / 8
"""Largest slope of the quintic smooth step, used for the velocity."""
MAX_YAW_RATE_RAD_S = 1.5
"""Yaw rate at full stick; corners are long enough to stay below it."""
MAX_HEIGHT_M = 100.0
MIN_HEIGHT_M = 0.10
"""Least height of a way point; the landing gear is 0.08 m high."""
MAX_DURATION_S = 6 * 3600.0


@dataclass(frozen=True)
class Manoeuvre:
    """Way points and speeds of a flight, or a script of commands."""

    way_points: Annotated[tuple[WayPoint, ...], Field(max_length=10_000)] = ()
    """Names of landmarks, or (x, y) or (x, y, z) in metres; a repeated point is a stop."""
    script: Annotated[tuple[Row, ...], Field(max_length=100_000)] | str = ()
    """Script instead of way points: a file, or its rows."""
    scale: Annotated[float, Field(ge=-1, le=1)] = 1.0
    """Factor of the script's commands."""
    start_m: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) at which a script starts, in the air and at rest."""
    may_land: bool = False
    """Whether a script may bring the vehicle down to the floor."""
    height_m: Annotated[float, Field(gt=0, le=MAX_HEIGHT_M)] = 0.8
    """Height of a script's start, and of way points without a height."""
    cruise_m_s: Annotated[float, Field(ge=0.01, le=20)] = 0.5
    acceleration_m_s2: Annotated[float, Field(ge=0.01, le=5)] = 1.0
    """Limit of the acceleration in corners, at the start and at the end."""
    heading: Literal["fixed", "along_path"] = "fixed"
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Heading at a script's start, and of a fixed heading; 0 is along +x."""
    laps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of times that the way points are flown; above 1 the path must be closed."""
    rest_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """Duration of the hover before the first leg or command and after the last."""


@dataclass(frozen=True)
class FlightPath:
    """(x, y, z, yaw) as a function of time from 0 to ``duration_s``, continuous to the third derivative."""

    derivatives: tuple[BPoly, BPoly, BPoly, BPoly]
    """The path in m and rad, and its first three derivatives with respect to time."""
    duration_s: float


def plan(
    manoeuvre: Manoeuvre, landmarks: dict[str, tuple[float, float]], extent_m: tuple[float, ...]
) -> FlightPath:
    """Plan the path through the way points, on the floor ``extent_m`` = (x0, y0, x1, y1).

    Raises ``InputError`` for a way point that is unknown, too low, too high or off the floor. Laps of an open
    path and a flight of more than six hours raise it too.
    """
    if not manoeuvre.way_points:
        raise InputError("maneuver.way_points: none; give one, or a script")
    points = _way_points(manoeuvre, landmarks, extent_m)
    yaws = _headings(manoeuvre, points)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    cruise = manoeuvre.cruise_m_s
    direction = np.diff(points, axis=0) / np.where(length > 0, length, 1.0)[:, None]
    turns = np.abs(np.diff(yaws)).max(initial=0.0)
    changes = np.diff(np.vstack([np.zeros(3), cruise * direction, np.zeros(3)]), axis=0)
    corner_s = max(
        STEP_PEAK_ACCELERATION * np.linalg.norm(changes, axis=1).max() / manoeuvre.acceleration_m_s2,
        STEP_PEAK_RATE * turns / MAX_YAW_RATE_RAD_S,
        0.1,
    )
    # A leg is longer than its corners, so that no two of them overlap.
    leg_s = np.maximum(length / cruise, 1.1 * corner_s)
    center_s = manoeuvre.rest_s + corner_s / 2 + np.concatenate([[0.0], np.cumsum(leg_s)])
    duration_s = float(center_s[-1] + corner_s / 2 + manoeuvre.rest_s)
    if duration_s > MAX_DURATION_S:
        raise InputError(
            f"maneuver: the flight would last {duration_s / 3600:.1f} h; 6 h is the most: "
            "fly faster or fewer laps"
        )
    velocity = np.vstack([np.zeros(3), np.diff(points, axis=0) / leg_s[:, None], np.zeros(3)])
    return FlightPath(_corners(points, velocity, yaws, center_s, corner_s, manoeuvre.rest_s), duration_s)


def _corners(
    points: Array, velocity: Array, yaws: Array, center_s: Array, corner_s: float, rest_s: float
) -> tuple[BPoly, BPoly, BPoly, BPoly]:
    """Return Hermite pieces between the start and the end of each corner; the path is straight there."""
    duration_s = center_s[-1] + corner_s / 2 + rest_s
    begin_end_s = np.column_stack([center_s - corner_s / 2, center_s + corner_s / 2])
    states = np.zeros((2 * len(points), 4, 4))
    for k, p in enumerate(points):
        for side, sign in ((0, -1), (1, 1)):
            state, leg = states[2 * k + side], k + side
            state[0] = [*(p + sign * corner_s / 2 * velocity[leg]), yaws[leg]]
            state[1, :3] = velocity[leg]
    times_s = begin_end_s.ravel()
    times_s[0], times_s[-1] = rest_s, duration_s - rest_s
    if rest_s > 0:
        times_s = np.concatenate([[0.0], times_s, [duration_s]])
        states = np.concatenate([states[:1], states, states[-1:]])
    path = BPoly.from_derivatives(times_s, list(states))
    return path, path.derivative(1), path.derivative(2), path.derivative(3)


def _headings(manoeuvre: Manoeuvre, points: Array) -> Array:
    """Return the unwrapped yaw (n + 1,) before, on and after the n - 1 legs."""
    if manoeuvre.heading == "fixed":
        return np.full(len(points) + 1, np.radians(manoeuvre.heading_deg))
    step = np.diff(points[:, :2], axis=0)
    moving = np.hypot(*step.T) > 1e-6
    yaws = np.arctan2(step[:, 1], step[:, 0])[moving]
    if len(yaws) == 0:
        return np.full(len(points) + 1, np.radians(manoeuvre.heading_deg))
    # A leg without horizontal motion keeps the heading of the previous leg.
    on_legs = np.unwrap(yaws)[np.maximum(np.cumsum(moving) - 1, 0)]
    return np.concatenate([on_legs[:1], on_legs, on_legs[-1:]])


def _way_points(
    manoeuvre: Manoeuvre, landmarks: dict[str, tuple[float, float]], extent_m: tuple[float, ...]
) -> Array:
    """Return the way points (n, 3) of all laps in metres."""
    once = [
        _way_point(k, way_point, manoeuvre, landmarks) for k, way_point in enumerate(manoeuvre.way_points)
    ]
    x0, y0, x1, y1 = extent_m
    for k, (x, y, z) in enumerate(once):
        name = f"maneuver.way_points[{k}] ({x:g}, {y:g}, {z:g})"
        if not (x0 <= x <= x1 and y0 <= y <= y1):
            raise InputError(
                f"{name} leaves the floor, which spans x {x0:g} to {x1:g} and y {y0:g} to {y1:g} m"
            )
        if not MIN_HEIGHT_M <= z <= MAX_HEIGHT_M:
            raise InputError(
                f"{name} is too near the ground or below: fly between {MIN_HEIGHT_M} and {MAX_HEIGHT_M:g} m"
            )
    if manoeuvre.laps > 1 and once[0] != once[-1]:
        raise InputError("maneuver.laps: way points flown more than once must end where they begin")
    return np.array(once + once[1:] * (manoeuvre.laps - 1), dtype=float)


def _way_point(
    k: int, way_point: WayPoint, manoeuvre: Manoeuvre, landmarks: dict[str, tuple[float, float]]
) -> tuple[float, float, float]:
    if isinstance(way_point, str):
        if way_point not in landmarks:
            known = ", ".join(landmarks) or "none"
            raise InputError(f"maneuver.way_points[{k}]: no landmark {way_point!r}; there are: {known}")
        return (*landmarks[way_point], manoeuvre.height_m)
    return (way_point[0], way_point[1], way_point[2] if len(way_point) == 3 else manoeuvre.height_m)
