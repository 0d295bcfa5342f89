"""Flights with ground control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from slam.core.control_points import SurveyedPoint
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.names import listed


def with_surveyed(
    flight: Flight,
    points: Sequence[SurveyedPoint],
    held_out: Sequence[str] = (),
    std_m: float | None = None,
) -> Flight:
    """Return the flight with surveyed points, those of the names ``held_out`` as check points.

    Points of the flight with the names of new ones are replaced. ``std_m`` is the standard deviation of all
    points along each axis; None leaves what they state. Raises ``InputError`` for an unknown name, and for
    ``std_m`` without points.
    """
    new = {point.name for point in points}
    every = (*(point for point in flight.surveyed if point.name not in new), *points)
    names = [point.name for point in every]
    if unknown := [name for name in held_out if name not in names]:
        known = f"the points are {listed(names)}" if names else "there are none; give --gcp FILE"
        raise InputError(f"--check {unknown[0]}: no control point of that name; {known}")
    if std_m is not None and not every:
        raise InputError("--gcp-std: there are no control points; give --gcp FILE")
    roles = tuple(replace(point, role="check") if point.name in held_out else point for point in every)
    if std_m is not None:
        roles = tuple(replace(point, std_m=std_m) for point in roles)
    return replace(flight, surveyed=roles).with_warning(*faults_of(points))


def faults_of(points: Sequence[SurveyedPoint]) -> tuple[Message, ...]:
    """Return a warning for each point whose coordinates cannot be used."""
    return tuple(warning(f"control point {point.name}: {point.fault}") for point in points if point.fault)
