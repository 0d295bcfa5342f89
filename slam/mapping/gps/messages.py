"""Remarks and warnings about GPS fixes that contradict the pictures, by photograph or time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import chi_square_limit
from backend.wording import counted, either
from slam.core.flight_info import MOST_LISTED_FIXES
from slam.core.messages import Message, about
from slam.core.names import listed
from slam.core.units import length
from slam.mapping.gps.agreeing_half import LEAST_FOR_HALF
from slam.mapping.gps.consensus import FALSE_ALARM, LEAST_FIXES, Agreement
from slam.mapping.gps.fixes import Fixes
from slam.mapping.gps.jumps import jumps

Array = NDArray[np.float64]

MOST_OUTLIERS = 0.3
"""Share of outliers up to which the fixes that agree are surely the right ones."""
_DOUBT = "so many may be right and the others wrong: check which, and remove the wrong ones"


@dataclass(frozen=True)
class FixMessages:
    """Remarks and warnings about the fixes of one part of the map."""

    remarks: tuple[Message, ...] = ()
    warnings: tuple[Message, ...] = ()
    """The result may be wrong."""
    left_out: tuple[str, ...] = ()
    """Names of the fixes that are not used."""


def fix_messages(fixes: Fixes, agreement: Agreement) -> FixMessages:
    """Return messages about fixes that are not used, and about fixes that are too few to compare."""
    covered = np.isfinite(agreement.off_m[:, 0])
    remarks, warnings = list[Message](), list[Message]()
    bad = np.flatnonzero(covered & ~agreement.used)
    if len(bad):
        distance = np.linalg.norm(np.nan_to_num(agreement.off_m[bad]), axis=1)
        line = about(
            "gps0",
            f"{len(bad)} of {agreement.count} fixes {either(len(bad), 'contradicts', 'contradict')} "
            f"the pictures and the other fixes, and {either(len(bad), 'is', 'are')} not used: "
            f"{_with_distance(fixes, bad, distance)}",
        )
        if too_many(len(bad), agreement.count):
            warnings.append(line.extended(_DOUBT))
        else:
            remarks.append(line.as_note())
    high = covered & agreement.used & np.isfinite(agreement.off_m[:, 2])
    bad_altitude = np.flatnonzero(high & ~agreement.altitude_used)
    good_altitude = np.flatnonzero(high & agreement.altitude_used)
    if len(bad_altitude):
        outliers, count = len(bad_altitude), len(bad_altitude) + len(good_altitude)
        step = _step(agreement.off_m[good_altitude, 2], agreement.off_m[bad_altitude, 2])
        if step is not None:
            warnings.append(_step_line(fixes, good_altitude, bad_altitude, step))
        else:
            line = about(
                "gps0",
                f"{outliers} of {count} altitudes {either(outliers, 'contradicts', 'contradict')} "
                "the pictures "
                f"and the other altitudes, and {either(outliers, 'is', 'are')} not used: "
                f"{_with_distance(fixes, bad_altitude, agreement.off_m[bad_altitude, 2])}",
            )
            if too_many(outliers, count):
                warnings.append(line.extended(_DOUBT))
            else:
                remarks.append(line.as_note())
    warnings += [
        *_too_few(fixes, agreement, covered),
        *_used_suspects(fixes, agreement, covered),
        *_jumps(fixes, agreement, covered),
    ]
    return FixMessages(tuple(remarks), tuple(warnings), tuple(fixes.names[k] for k in bad.tolist()))


def too_many(outliers: int, count: int) -> bool:
    """Return whether so many of the fixes are outliers that they may be the right ones."""
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


def _step_line(fixes: Fixes, good: NDArray[np.int64], bad: NDArray[np.int64], step_m: float) -> Message:
    def group(which: NDArray[np.int64]) -> str:
        return f"{len(which)} fixes from {fixes.names[which[0]]} to {fixes.names[which[-1]]}"

    where = "above" if step_m > 0 else "below"
    return about(
        "gps0",
        f"the altitudes of {group(bad)} lie {length(abs(step_m))} {where} those of the other {group(good)} "
        "while the pictures show no such climb: two altitude references (sea level, ellipsoid, take-off)? "
        "The map uses those of the latter",
        "check which are right",
    )


def _too_few(fixes: Fixes, agreement: Agreement, covered: NDArray[np.bool_]) -> list[Message]:
    """Return a warning where fixes contradict the pictures but are too few to tell which are wrong."""
    used = covered & agreement.used
    n = int(used.sum())
    if not 2 < n < LEAST_FOR_HALF or not _exceed_nominal(fixes, agreement, used):
        return []
    names = ", ".join(name for name, here in zip(fixes.names, used, strict=True) if here)
    rms = float(np.sqrt(np.sum(agreement.off_m[used, :2] ** 2) / (2 * n - 4)))
    which = (
        f"{LEAST_FIXES} to tell which is" if n < LEAST_FIXES else f"{LEAST_FOR_HALF} to tell which half is"
    )
    return [
        about(
            "gps0",
            f"the {n} fixes contradict the pictures by {length(rms)}, and it takes {which} wrong ({names})",
            "scale and place of the map may be wrong: check the fixes, or add control points",
        )
    ]


def _used_suspects(fixes: Fixes, agreement: Agreement, covered: NDArray[np.bool_]) -> list[Message]:
    """Return a warning where the noise hides whether fixes that contradict the other fixes are outliers."""
    used = covered & agreement.used
    suspects = np.flatnonzero(used & fixes.suspect)
    if not len(suspects) or int(used.sum()) < 3 or not _exceed_nominal(fixes, agreement, used):
        return []
    rms = float(np.sqrt(np.mean(agreement.off_m[used, :2] ** 2)))
    names = listed([fixes.names[k] for k in suspects], MOST_LISTED_FIXES)
    return [
        about(
            "gps0",
            f"the map uses {counted(len(suspects), 'fix', 'fixes')} out of reach of the others ({names}), "
            f"because the fixes differ from it by {length(rms)} a horizontal axis anyway",
            f"if {either(len(suspects), 'this one is', 'these are')} wrong, so are its scale and place: "
            "check them",
        )
    ]


def _jumps(fixes: Fixes, agreement: Agreement, covered: NDArray[np.bool_]) -> list[Message]:
    """Return a warning where the fixes jump while the pictures show no such step."""
    if fixes.stated:  # the pattern of the differences says more (`slam.mapping.gps.stated_accuracy`)
        return []
    used = np.flatnonzero(covered & agreement.used)
    found = jumps(agreement.off_m[used, :2], fixes.std_m)
    if not len(found):
        return []
    step_m = np.linalg.norm(np.diff(agreement.off_m[used, :2], axis=0), axis=1)[found - 1]
    steps = [
        f"{length(step)} from {fixes.names[used[k - 1]]} to {fixes.names[used[k]]}"
        for k, step in zip(found, step_m, strict=True)
    ]
    return [
        about(
            "gps0",
            f"the fixes jump against the pictures by {listed(steps, MOST_LISTED_FIXES)}: those before or "
            "those after are wrong, and so may be scale, heading and place of the map",
            "remove the wrong ones",
        )
    ]


def _exceed_nominal(fixes: Fixes, agreement: Agreement, used: NDArray[np.bool_]) -> bool:
    """Return whether the fixes ``used`` (n,), three at least, differ from the map by more than is nominal."""
    squares = float(np.sum((agreement.off_m[used, :2] / fixes.each_std_m[used, :2]) ** 2))
    return squares >= chi_square_limit(FALSE_ALARM, 2 * int(used.sum()) - 4)
