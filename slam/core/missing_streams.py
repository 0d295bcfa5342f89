"""Streams that were not recorded, and what a map does without them."""

from __future__ import annotations

import math

import numpy as np

from slam.core.errors import NO_CAMERA
from slam.core.flight import Flight
from slam.core.messages import Message, note, warning


def missing_for_map(flight: Flight) -> tuple[Message, ...]:
    """Return the streams that were not recorded, and what the map does without them.

    The scale is not among them: it is reported with the map.
    """
    if flight.all_keyframes:
        return ()  # photographs: the import has reported the assumptions
    if flight.parts:
        return tuple(line.after(part.name) for part in flight.parts for line in missing_for_map(part))
    lines = []
    if flight.attitude is None:
        lines.append(
            warning(
                "no attitude: tilt is not measured, the camera is assumed to look straight down, and a "
                "tilted flight gives a bent map",
                "record attitude0, or use a gimbal",
            )
        )
    if flight.imu is None:
        lines.append(
            note(
                "no IMU: segments where pictures do not match cannot be bridged, and the map may fall into "
                "parts",
                "record imu0, or keep the floor in view",
            )
        )
    return tuple(lines)


def missing_streams(flight: Flight) -> list[Message]:
    """Return the streams that were not recorded, and what cannot be done without them."""
    if flight.camera is None or flight.frames is None:
        lines = [warning(f"{flight.reason_not_read('cam0') or 'no camera'}: there is no map", NO_CAMERA)]
    else:
        lines = [*_missing_for_scale(flight), *missing_for_map(flight)]
    if flight.truth is None and flight.gps is None:
        lines.append(warning("no truth and no GPS: the result cannot be evaluated"))
    if flight.command is None and not flight.all_keyframes:
        lines.append(warning("no commands: the flight cannot be replayed in the simulator"))
    return lines


def _missing_for_scale(flight: Flight) -> list[Message]:
    """Return what is missing for the scale of a map and its place on Earth."""
    control = [p for p in flight.surveyed if p.role == "control" and not p.fault]
    if flight.gps is None and any(math.isfinite(p.altitude_m) for p in control):
        return [
            warning(
                "no GPS: the control points place the map and tell its lengths, if it shows three or more"
            )
        ]
    on_earth = [] if flight.gps is not None else [warning("no GPS: the map is not placed on Earth")]
    if flight.sonar is not None and np.isfinite(flight.sonar.range_m).any():
        return on_earth
    if flight.gps is not None:
        return [
            warning(
                "no sonar: the scale comes from GPS alone and is only as accurate as GPS",
                "record a height sensor, or measure one distance on the ground",
            )
        ]
    if flight.imu is not None:
        source = (
            "lengths come from the accelerometer, if the flight moves it enough: fly curves, and measure one "
            "distance on the ground"
        )
    elif flight.barometer is not None:
        source = (
            "no metric scale but that of the barometer's changes of height: check it by one distance on the "
            "ground"
        )
    elif flight.velocity is not None and flight.attitude is not None:
        source = (
            "no metric scale but that of the vehicle's own velocity: check it by one distance on the ground"
        )
    else:
        lacking = warning(
            "no sonar and no GPS: no metric scale",
            "distances in the map are relative",
            "record a height sensor, or measure one distance on the ground and scale the map by it",
        )
        return [lacking, *on_earth]
    return [warning(f"no sonar and no GPS: {source}"), *on_earth]
