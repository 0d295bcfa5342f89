"""Remarks and warnings about GPS fixes that contradict the pictures, by photograph or time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit
from slam.core.flight_info import MOST_LISTED_FIXES
from slam.core.names import listed
from slam.core.units import length
from slam.mapping.gps.consensus import FALSE_ALARM, LEAST_FIXES, Agreement
from slam.mapping.gps.fixes import Fixes

Array = NDArray[np.float64]

MOST_OUTLIERS = 0.3
"""Share of outliers up to which the fixes that agree are surely the right ones."""
_DOUBT = "; so many may be right and the others wrong: check which, and remove the wrong ones"


@dataclass(frozen=True)
class FixMessages:
    """Remarks and warnings about the fixes of one part of the map."""

    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    """The result may be wrong."""


def fix_messages(fixes: Fixes, agreement: Agreement) -> FixMessages:
    """Return messages about fixes that are not used, and about fixes that are too few to compare."""
    covered = np.isfinite(agreement.off_m[:, 0])
    remarks, warnings = [], []
    bad = np.flatnonzero(covered & ~agreement.used)
    if len(bad):
        distance = np.linalg.norm(np.nan_to_num(agreement.off_m[bad]), axis=1)
        line = (
            f"gps0: {len(bad)} of {agreement.count} fixes contradict the pictures and the other fixes, and "
            f"are not used: {_with_distance(fixes, bad, distance)}"
        )
        if _too_many(len(bad), agreement.count):
            warnings.append(line + _DOUBT)
        else:
            remarks.append(line)
    high = covered & agreement.used & np.isfinite(agreement.off_m[:, 2])
    bad_altitude = np.flatnonzero(high & ~agreement.altitude_used)
    good_altitude = np.flatnonzero(high & agreement.altitude_used)
    if len(bad_altitude):
        outliers, count = len(bad_altitude), len(bad_altitude) + len(good_altitude)
        step = _step(agreement.off_m[good_altitude, 2], agreement.off_m[bad_altitude, 2])
        if step is not None:
            warnings.append(_step_line(fixes, good_altitude, bad_altitude, step))
        else:
            line = (
                f"gps0: {outliers} of {count} altitudes contradict the pictures and the other altitudes, and "
                f"are not used: {_with_distance(fixes, bad_altitude, agreement.off_m[bad_altitude, 2])}"
            )
            if _too_many(outliers, count):
                warnings.append(line + _DOUBT)
            else:
                remarks.append(line)
    return FixMessages(tuple(remarks), (*warnings, *_too_few(fixes, agreement, covered)))


def _too_many(outliers: int, count: int) -> bool:
    return outliers > math.ceil(MOST_OUTLIERS * count)


def _with_distance(fixes: Fixes, which: NDArray[np.int64], off_m: Array) -> str:
    described = [f"{fixes.names[k]} ({length(off)})" for k, off in zip(which, off_m, strict=True)]
    return listed(described, MOST_LISTED_FIXES)


def _step(good_m: Array, bad_m: Array) -> float | None:
    """Return the step between two groups of altitudes; None if the second is no group."""
    if len(bad_m) < 2 or not len(good_m):
        return None
    # A group is narrower than the gap that separates it from the others.
    gap_m = float(np.abs(bad_m[:, None] - good_m).min())
    if np.ptp(bad_m) > gap_m:
        return None
    return float(np.median(bad_m) - np.median(good_m))


def _step_line(fixes: Fixes, good: NDArray[np.int64], bad: NDArray[np.int64], step_m: float) -> str:
    def group(which: NDArray[np.int64]) -> str:
        return f"{len(which)} fixes from {fixes.names[which[0]]} to {fixes.names[which[-1]]}"

    where = "above" if step_m > 0 else "below"
    return (
        f"gps0: the altitudes of {group(bad)} lie {length(abs(step_m))} {where} those of the other "
        f"{group(good)} while the pictures show no such climb: two altitude references (sea level, "
        "ellipsoid, take-off)? The map uses those of the latter; check which are right"
    )


def _too_few(fixes: Fixes, agreement: Agreement, covered: NDArray[np.bool_]) -> list[str]:
    """Return a warning where fixes contradict the pictures but are too few to tell which is wrong."""
    off, n = agreement.off_m[covered, :2], int(covered.sum())
    if not 2 < n < LEAST_FIXES:
        return []
    sums = float(np.sum((off / np.array(fixes.std_m[:2])) ** 2))
    if sums < chi_square_limit(FALSE_ALARM, 2 * n - 4):
        return []
    names = ", ".join(name for name, here in zip(fixes.names, covered, strict=True) if here)
    rms = float(np.sqrt(np.sum(off**2) / max(2 * n - 4, 1)))
    return [
        f"gps0: the {n} fixes contradict the pictures by {length(rms)}, and it takes {LEAST_FIXES} to tell "
        f"which is wrong ({names}); scale and place of the map may be wrong"
    ]
