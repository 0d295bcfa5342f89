"""Warnings about control points and check points."""

from __future__ import annotations

import numpy as np

from backend.quantiles import chi_square_limit
from backend.significance import FALSE_ALARM
from backend.wording import either
from slam.core.control_points import ControlReport
from slam.core.messages import Message, warning
from slam.core.names import listed
from slam.mapping.control_points import LEAST_POINTS
from slam.mapping.warnings.gps_offset import offset_warnings


def control_warnings(report: ControlReport) -> list[Message]:
    """Return lines about control points that are wrong, or too few, and about check points that are off."""
    control = report.of_role("control")
    located = [p for p in control if p.residual_m is not None]
    used = [p for p in control if p.used]
    wrong = [p for p in located if not p.used]
    lines = []
    if report.misread:
        lines.append(
            warning(
                f"control points: none is used: {report.misread}",
                "count pixels from the upper left corner of the stored picture at its full size, the "
                "column before the row",
            )
        )
    elif control and not used:
        if len(located) < LEAST_POINTS:
            what = f"{len(located)} of {len(control)} can be placed, and {LEAST_POINTS} are needed"
        else:
            what = f"fewer than {LEAST_POINTS} agree with each other, and nobody can tell which are right"
        lines.append(
            warning(f"control points: none is used: {what}", "check those that are far off in the report")
        )
    elif wrong:
        each = listed([f"{p.name} by {p.distance_m:.3g} m" for p in wrong])
        lines.append(
            warning(
                f"control points: {len(wrong)} of {len(located)} "
                f"{either(len(wrong), 'contradicts', 'contradict')} the others and the pictures, and "
                f"{either(len(wrong), 'is', 'are')} not used: {each}",
                "check their coordinates and pixels",
            )
        )
    return [*lines, *offset_warnings(report), *_check_warnings(report)]


def _check_warnings(report: ControlReport) -> list[Message]:
    if not report.checks:
        return []
    off = np.array([p.residual_m for p in report.checks], dtype=float)
    std = np.array([p.std_m for p in report.checks], dtype=float)
    known = np.isfinite(off)
    dof = int(known.sum())
    if not report.is_followed:
        # What they share is compared with the GPS by itself (`slam.mapping.warnings.gps_offset`).
        off = off - np.array(report.gps_offset_m if report.gps_offset_m is not None else np.zeros(3))
        dof -= int(known.any(axis=0).sum())
    z = (off / std)[known]
    if dof < 1 or float(np.sum(z**2)) <= chi_square_limit(FALSE_ALARM, dof):
        return []
    off_m = np.sqrt(np.nansum(off**2, axis=1)).max()
    beside = "" if report.is_followed else " beside what all of them share"
    return [
        warning(
            f"check points lie up to {off_m:.3g} m from the map{beside}, {np.sqrt(np.mean(z**2)):.2g} times "
            "their standard deviation: the map is less accurate than it states, or a check point is wrong",
            "check their coordinates and pixels",
        )
    ]
