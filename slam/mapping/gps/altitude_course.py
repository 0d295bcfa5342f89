"""Course of the altitudes against the map: a drift in time, or a step where the recording pauses.

The map follows the altitudes in its height and its slopes, and takes what is left as their noise. A drift or
a step stands out of that noise although it is smaller than a deviation that is assumed for each altitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.quantiles import f_limit
from slam.core.units import length
from slam.mapping.gps.consensus import FALSE_ALARM

Array = NDArray[np.float64]

_PAUSE = 10.0
"""Time between two fixes, over the median, from which on the vehicle may have landed in between."""
_PARAMETERS = 4
"""Level and two slopes of the map, and the size of the course."""
_LEAST_LEFT = 4
"""Altitudes beyond the parameters, for a standard deviation."""


@dataclass(frozen=True)
class AltitudesOnMap:
    """Altitudes that the map uses, in order of time."""

    up_m: Array
    """(n,) altitude minus map."""
    w_p_m: Array
    """(n, 2) place on the map."""
    stamps_s: Array
    """(n,)."""
    names: Sequence[str]
    """(n,)."""


def altitude_course(altitudes: AltitudesOnMap, nominal_m: float) -> str:
    """Return how the altitudes drift or step against the map by surely more than ``nominal_m``; empty
    where they do not."""
    n = len(altitudes.up_m)
    dof = n - _PARAMETERS
    if dof < _LEAST_LEFT:
        return ""
    centred = altitudes.w_p_m - altitudes.w_p_m.mean(axis=0)
    plane = np.column_stack([np.ones(n), centred / max(float(np.abs(centred).max()), 1e-9)])
    for course, first in _courses(altitudes):
        J = np.column_stack([plane, course])
        if np.linalg.matrix_rank(J) < J.shape[1]:
            continue
        parameters = np.linalg.lstsq(J, altitudes.up_m, rcond=None)[0]
        variance = float(np.sum((altitudes.up_m - J @ parameters) ** 2)) / dof
        size_m, size_std_m = float(parameters[-1]), float(np.sqrt(variance * np.linalg.inv(J.T @ J)[-1, -1]))
        if abs(size_m) > nominal_m + size_std_m * np.sqrt(f_limit(FALSE_ALARM, 1, dof)):
            return _line(size_m, altitudes.names, first)
    return ""


def _courses(altitudes: AltitudesOnMap) -> Iterator[tuple[Array, int]]:
    """Yield a drift over all of the time, and a step at the longest pause, with the first fix after it."""
    stamps_s = altitudes.stamps_s
    lasted_s = np.diff(stamps_s)
    after = int(np.argmax(lasted_s)) + 1
    if lasted_s[after - 1] > _PAUSE * float(np.median(lasted_s)):
        yield (np.arange(len(stamps_s)) >= after).astype(float), after
    elif stamps_s[-1] > stamps_s[0]:
        yield (stamps_s - stamps_s[0]) / (stamps_s[-1] - stamps_s[0]), 0


def _line(size_m: float, names: Sequence[str], first: int) -> str:
    size, where = length(abs(size_m)), "above" if size_m > 0 else "below"
    if first:
        return f"those from {names[first]} on lie {size} {where} those up to {names[first - 1]}"
    moves = "rise" if size_m > 0 else "fall"
    return f"they {moves} against the pictures by {size} from {names[0]} to {names[-1]}"
