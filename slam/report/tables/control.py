"""Table of the control points and check points of a map."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from slam.core.control_points import ControlReport, PointResidual, Role
from slam.core.figure_table import UNKNOWN, FigureTable
from slam.core.units import SPACE

_ROLES: dict[Role, str] = {"control": "control point", "check": "check point"}
_TITLE = "Control points and check points: place on the map minus surveyed place"
_COLUMNS = (
    "point", "role", "pictures", "east [m]", "north [m]", "up [m]", "1σ [m]", "off in pictures [px]", "used",
)  # fmt: skip


def control_tables(report: ControlReport | None) -> tuple[FigureTable, ...]:
    """Return the table of all points and the RMS of each role; none without points."""
    if report is None:
        return ()
    rows = [_row(point) for point in report.points]
    for role in _ROLES:
        rows += _rms(report, role)
    if report.gps_offset_m is not None and report.gps_offset_std_m is not None:
        rows.append(
            (
                f"GPS minus {'control' if report.is_followed else 'check'} points", "offset", "",
                *map(_metres, report.gps_offset_m), _stds(report.gps_offset_std_m), "", "",
            )
        )  # fmt: skip
    return (FigureTable(_TITLE, _COLUMNS, tuple(rows)),)


def _row(point: PointResidual) -> tuple[str, ...]:
    off = [UNKNOWN] * 3 if point.residual_m is None else [_metres(x) for x in point.residual_m]
    std = UNKNOWN if point.std_m is None else _stds(point.std_m)
    pixels = UNKNOWN if point.residual_px is None else f"{point.residual_px:.2f}"
    used = "yes" if point.used else f"no: {point.reason}" if point.reason else "held out"
    return (point.name, _ROLES[point.role], str(point.views), *off, std, pixels, used)


def _rms(report: ControlReport, role: Role) -> list[tuple[str, ...]]:
    """Return the row of a role: the control points that are used, and all check points with coordinates."""
    points = [p for p in report.of_role(role) if p.residual_m is not None and (p.used or not p.reason)]
    if not points:
        return []
    axes = zip(*(p.residual_m for p in points if p.residual_m is not None), strict=True)
    off = [_root_mean_square([x for x in axis if math.isfinite(x)]) for axis in axes]
    pixels = _root_mean_square([p.residual_px for p in points if p.residual_px is not None])
    count = f"RMS of {len(points)} {_ROLES[role]}{'s' * (len(points) > 1)}"
    return [(count, "", "", *(_metres(x).lstrip("+") for x in off), "", f"{pixels:.2f}", "")]


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else math.nan


def _metres(x: float) -> str:
    return f"{x:+.3f}" if math.isfinite(x) else UNKNOWN


def _stds(stds: tuple[float, float, float]) -> str:
    known = [f"{x:.2g}" if math.isfinite(x) else UNKNOWN for x in stds]
    return f",{SPACE}".join(known)
