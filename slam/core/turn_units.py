"""Attitude in degrees, or a gyro in degrees per second, where radians are asked for.

The two measure the same turns. No error of an instrument makes one of them 57 times as large as the other,
and no unit makes one as much smaller: the larger one is in degrees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from backend.clocks.delay_residuals import gyro_attitudes
from slam.core.flight import Flight
from slam.core.instrument_readings import MAX_GAP_S, attitude_readings, inertial_readings
from slam.core.messages import Message, warning

Array = NDArray[np.float64]

STEP_S = 0.1
"""Time over which turns are compared: many readings of a gyro, and short beside a manoeuvre."""
LEAST_STEPS, ALIKE, TOLERANCE = 30, 0.5, 0.2
"""Fewest steps; least correlation of the turns; largest deviation of their ratio from 180 / pi. With Euler
angles of a tilted vehicle the ratio is a few percent off."""


def in_radians(flight: Flight) -> Flight:
    """Return the flight with attitude and gyro in radians, with a warning where one was not."""
    ratio = turn_ratio(flight)
    if ratio is None or flight.imu is None or flight.attitude is None:
        return flight
    if abs(ratio / np.degrees(1) - 1) < TOLERANCE:
        angles = np.radians(flight.attitude.roll_pitch_yaw_rad)
        return replace(flight, attitude=replace(flight.attitude, roll_pitch_yaw_rad=angles)).with_warning(
            _said("attitude0", "imu0's gyro", "degrees", "radians")
        )
    if abs(ratio * np.degrees(1) - 1) < TOLERANCE:
        rates = np.radians(flight.imu.gyro_rad_s)
        return replace(flight, imu=replace(flight.imu, gyro_rad_s=rates)).with_warning(
            _said("imu0's gyro", "attitude0", "deg/s", "rad/s")
        )
    return flight


def turn_ratio(flight: Flight) -> float | None:
    """Return how many times as far the attitude turns as the gyro, in roll and pitch; None if that is vague.

    It is the regression of the attitude's turns on the gyro's, whose noise is small over a step.
    """
    readings = inertial_readings(flight.imu)
    if readings is None or flight.attitude is None:
        return None
    at_s, angles = _within(*attitude_readings(flight.attitude, axes=(0, 1)), readings.stamps_s)
    if len(at_s) < LEAST_STEPS:
        return None
    w_R_b = Rotation.from_matrix(gyro_attitudes(readings, at_s))
    short = np.diff(at_s) < MAX_GAP_S
    a, g = np.diff(angles, axis=0)[short], (w_R_b[:-1].inv() * w_R_b[1:]).as_rotvec()[short, :2]
    a, g = a - np.median(a, axis=0), g - np.median(g, axis=0)
    both = float(np.sqrt((a**2).sum() * (g**2).sum()))
    if len(a) < LEAST_STEPS or both == 0 or (a * g).sum() < ALIKE * both:
        return None
    return float((a * g).sum() / (g**2).sum())


def _within(at_s: Array, values: Array, stamps_s: Array) -> tuple[Array, Array]:
    """Return samples about `STEP_S` apart, within the times of other ``stamps_s``."""
    inside = np.flatnonzero((at_s >= stamps_s[0]) & (at_s <= stamps_s[-1]))
    steps = np.floor(at_s[inside] / STEP_S)
    chosen = inside[np.append(True, np.diff(steps) > 0)] if len(inside) else inside
    return at_s[chosen], values[chosen]


def _said(stream: str, other: str, given: str, asked: str) -> Message:
    return warning(
        f"{stream}: turns 57 times as far as {other}: taken as {given}, and used in {asked}",
        "correct the unit in the recording, since other programs would not notice",
    )
