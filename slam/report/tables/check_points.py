"""How far a map lies from its check points, in words."""

from __future__ import annotations

import itertools

import numpy as np

from backend.wording import counted
from slam.core.control_points import ControlReport
from slam.core.names import enumerated
from slam.core.units import length, percent


def off_check_points(control: ControlReport) -> str:
    """Return the root mean square of the residuals along each axis, in a sentence."""
    lines = []
    for name, axis in zip(("east", "north", "up"), zip(*_residuals_m(control), strict=True), strict=True):
        if known := [x for x in axis if np.isfinite(x)]:
            lines.append(f"{length(float(np.sqrt(np.mean(np.square(known)))))} {name}")
    points = counted(len(control.checks), "check point", "check points")
    return (
        f"At {points}, which the map does not follow, it is off by {enumerated(lines)} (root mean square), "
        f"and by {length(max(point.distance_m for point in control.checks))} at most."
    )


def checked_lengths(control: ControlReport) -> str:
    """Return how long the map has the longest distance between two check points, in a sentence; empty where
    there is none."""
    places = [
        (p.name, np.array(p.surveyed_m), np.array(p.residual_m)) for p in control.checks if p.surveyed_m
    ]
    longest_m, text = 0.0, ""
    for (one, p_m, off_p_m), (other, q_m, off_q_m) in itertools.combinations(places, 2):
        surveyed_m = float(np.linalg.norm((q_m - p_m)[:2]))
        if surveyed_m <= longest_m:
            continue
        off = float(np.linalg.norm((q_m + off_q_m - p_m - off_p_m)[:2])) / surveyed_m - 1
        longest_m = surveyed_m
        text = (
            f"The longest distance between two of them, {length(surveyed_m)} from {one} to {other}, is "
            f"{percent(abs(off))} {'longer' if off > 0 else 'shorter'} on the map."
        )
    return text


def _residuals_m(control: ControlReport) -> list[tuple[float, float, float]]:
    return [point.residual_m for point in control.checks if point.residual_m is not None]
