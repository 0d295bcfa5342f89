"""Warnings about a constant by which GPS positions lie off surveyed points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit
from backend.significance import FALSE_ALARM
from slam.core.control_points import ControlReport
from slam.core.messages import Message, note, warning
from slam.core.names import enumerated
from slam.core.units import FOOT_M, length

Array = NDArray[np.float64]

_DATUMS_M = 5.0
"""Standard deviation, along x and y, of what positions without corrections share, and of datums that follow
different continents: metres."""
_LARGEST_UNDULATION_M = 106.0
"""Largest difference between heights over the ellipsoid and over the sea. Source: EGM2008."""
_FACTORS = {
    FOOT_M: "they fit if heights of the points are in feet: name the unit by a system of heights, such as "
    "EPSG:2232+6360, or write metres",
    1 / FOOT_M: "they fit if heights of the points are in metres, not in feet: name a system of heights in "
    "metres",
    -1.0: "they fit if heights of the points have the wrong sign",
}
"""Factor on heights of the points -> what makes it."""
_OTHER_HEIGHTS = "check unit, sign and reference of both heights"


@dataclass(frozen=True)
class _Offset:
    """The offset of a report, east, north and up; NaN along an axis that is not compared."""

    report: ControlReport
    off_m: Array
    """(3,)."""
    std_m: Array
    """(3,)."""
    fix_m: Array
    """(3,) standard deviations of one fix: what all fixes share is no larger."""

    @staticmethod
    def of(report: ControlReport) -> _Offset | None:
        """Return the offset; None without one."""
        if report.gps_offset_m is None or report.gps_offset_std_m is None or report.gps_std_m is None:
            return None
        off, std, fix = map(np.array, (report.gps_offset_m, report.gps_offset_std_m, report.gps_std_m))
        return _Offset(report, off, std, fix)

    def exceeds(self, axes: slice, further_m: float = 0.0) -> bool:
        """Return whether the offset along some axes is larger than its deviation, that of a fix and
        ``further_m`` explain."""
        z = (self.off_m / np.sqrt(self.std_m**2 + self.fix_m**2 + further_m**2))[axes]
        z = z[np.isfinite(z)]
        return bool(len(z)) and float(np.sum(z**2)) > chi_square_limit(FALSE_ALARM, len(z))

    @property
    def largest_rise_m(self) -> float:
        """Largest vertical offset that two references of heights explain."""
        sigmas = np.sqrt(chi_square_limit(FALSE_ALARM, 1))
        return float(_LARGEST_UNDULATION_M + sigmas * np.hypot(self.std_m[2], self.fix_m[2]))

    @property
    def is_beyond_references(self) -> bool:
        """Whether no two references of heights explain the vertical offset."""
        return bool(abs(self.off_m[2]) > self.largest_rise_m)

    @property
    def size_m(self) -> float:
        """Length of the horizontal offset."""
        return float(np.hypot(*self.off_m[:2]))

    @property
    def where(self) -> str:
        """The horizontal offset in words."""
        east, north = self.off_m[:2].tolist()
        return enumerated(
            [
                f"{length(abs(east))} {'east' if east > 0 else 'west'}",
                f"{length(abs(north))} {'north' if north > 0 else 'south'}",
            ]
        )

    @property
    def rise(self) -> str:
        """The vertical offset in words."""
        up = float(self.off_m[2])
        return f"{length(abs(up))} {'above' if up > 0 else 'below'}"

    @property
    def fit(self) -> str:
        """The error that explains a vertical offset which references of heights do not."""
        surveyed_m = self.report.altitude_m
        if surveyed_m is None:
            return _OTHER_HEIGHTS
        left = {abs(surveyed_m + self.off_m[2] - f * surveyed_m): said for f, said in _FACTORS.items()}
        least = min(left)
        return left[least] if least <= self.largest_rise_m else _OTHER_HEIGHTS


def offset_warnings(report: ControlReport) -> list[Message]:
    """Return lines for the status about GPS positions that lie farther off surveyed points than datums and
    references of heights do; off check points alone, farther than the accuracy of the fixes."""
    offset = _Offset.of(report)
    if offset is None:
        return []
    if not report.is_followed:
        return _off_check_points(offset)
    lines = []
    if offset.exceeds(slice(2), _DATUMS_M):
        lines.append(
            warning(
                f"control points: the GPS lies {length(offset.size_m)} off all of them alike "
                f"({offset.where} of them), farther than datums differ: datum, zone or base station of "
                "one of both is wrong",
                "the map is where the control points are: check their coordinate system",
            )
        )
    if offset.is_beyond_references:
        lines.append(
            warning(
                f"control points: the altitudes of the GPS lie {offset.rise} them, farther than "
                f"references of heights differ ({_LARGEST_UNDULATION_M:.0f} m): {offset.fit}",
                "the map has the heights of the control points",
            )
        )
    return lines


def _off_check_points(offset: _Offset) -> list[Message]:
    lines = []
    if offset.exceeds(slice(2)):
        lines.append(
            warning(
                f"check points: the map lies {length(offset.size_m)} off all of them alike "
                f"({offset.where} of them), farther than its GPS explains: check their coordinate system, "
                "and the datum and the base station of the GPS, or use points as control points, which "
                "place the map"
            )
        )
    if offset.exceeds(slice(2, 3)):
        off = f"check points: the map lies {offset.rise} all of them alike, farther than its GPS explains"
        lines.append(
            warning(f"{off}: {offset.fit}")
            if offset.is_beyond_references
            else warning(
                f"{off}: heights over the ellipsoid, over the sea and over the take-off differ so",
                "use points as control points, which give the map their heights",
            )
        )
    return lines


def offset_remarks(report: ControlReport) -> list[Message]:
    """Return lines about an offset from control points that datums explain, but not what the fixes state."""
    offset = _Offset.of(report)
    if offset is None or not (report.is_followed and report.gps_is_stated):
        return []
    lines = []
    if offset.exceeds(slice(2)) and not offset.exceeds(slice(2), _DATUMS_M):
        lines.append(
            warning(
                f"control points: the GPS lies {length(offset.size_m)} off all of them alike ({offset.where} "
                f"of them), far more than the {length(float(offset.fix_m[:2].max()))} that its fixes state: "
                "another datum, or a base station that is off",
                "the map is where the control points are: check their coordinate system",
            )
        )
    if offset.exceeds(slice(2, 3)) and not offset.is_beyond_references:
        lines.append(
            note(
                f"the altitudes of the GPS lie {offset.rise} the control points, as those over another "
                "reference do",
                "the map has the heights of the control points",
            )
        )
    return lines
