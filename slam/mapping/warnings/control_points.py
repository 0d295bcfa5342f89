"""Warnings about control points and check points."""

from __future__ import annotations

import numpy as np

from backend.quantiles import chi_square_limit
from backend.wording import either
from slam.core.control_points import ControlReport
from slam.core.names import listed
from slam.mapping.control_points import LEAST_POINTS

_CHECK_FALSE_ALARM = 1e-3
"""Probability that check points are said to contradict a map whose deviations are right."""


def control_warnings(report: ControlReport) -> list[str]:
    """Return lines about control points that are wrong, or too few, and about check points that are off."""
    control = report.of_role("control")
    located = [p for p in control if p.residual_m is not None]
    used = [p for p in control if p.used]
    wrong = [p for p in located if not p.used]
    lines = []
    if control and not used:
        if len(located) < LEAST_POINTS:
            what = f"{len(located)} of {len(control)} can be placed, and {LEAST_POINTS} are needed"
        else:
            what = f"fewer than {LEAST_POINTS} agree with each other, and nobody can tell which are right"
        lines.append(f"control points: none is used: {what}; check those that are far off in the report")
    elif wrong:
        each = listed([f"{p.name} by {p.distance_m:.3g} m" for p in wrong])
        lines.append(
            f"control points: {len(wrong)} of {len(located)} "
            f"{either(len(wrong), 'contradicts', 'contradict')} the others and the pictures, and "
            f"{either(len(wrong), 'is', 'are')} not used: {each}; check their coordinates and pixels"
        )
    return lines + _check_warnings(report)


def _check_warnings(report: ControlReport) -> list[str]:
    checks = [p for p in report.of_role("check") if p.residual_m is not None and p.std_m is not None]
    z = np.array([[x / s for x, s in zip(p.residual_m or (), p.std_m or (), strict=True)] for p in checks])
    z = z[np.isfinite(z)] if len(z) else z
    if not any(p.used for p in report.points) or not len(z):
        return []
    if float(np.sum(z**2)) <= chi_square_limit(_CHECK_FALSE_ALARM, len(z)):
        return []
    off_m = max(p.distance_m for p in checks)
    return [
        f"check points lie up to {off_m:.3g} m from the map, {np.sqrt(np.mean(z**2)):.2g} times their "
        "standard deviation: the map is less accurate than it states, or a check point is wrong; check their "
        "coordinates and pixels"
    ]
