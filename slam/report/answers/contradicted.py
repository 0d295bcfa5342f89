"""Matches that the rest of a map contradicts: inexact ones of the right place, or ones of another place."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from backend.measurements.rejection import LinkCheck, Rejection
from backend.wording import counted, either
from slam.core.estimate import Estimate, LoopVerdict
from slam.core.units import length
from slam.report.facts import median_height_m

_MISS = re.compile(r"([\d.e+-]+) (m|heights), ([\d.e+-]+) deg$")
"""The end of the figures of a match that the pose graph rejected: by how much it misses the map."""
_SAME_PLACE = 0.2
"""Largest miss, in heights of the camera, of a match that still shows the right place. A picture shows about
one height of ground to each side; the search for loops accepts this as well (``plausible_heights``)."""


def contradicted(estimate: Estimate, loops: Sequence[LoopVerdict]) -> str:
    """Return how many matches show the right place but inexactly, and how many another place."""
    if not loops:
        return ""
    height_m = median_height_m(estimate)
    misses = [_miss(loop.rejection, height_m, estimate.metric) for loop in loops if loop.rejection]
    near = sorted(miss for miss in misses if miss is not None and miss <= _SAME_PLACE)
    text, far = f"the rest of the map contradicts {len(loops)}", len(misses) - len(near)
    if not near:
        return f"{text} (another place that looks alike, or a wrong fit)"
    unit_m = height_m if estimate.metric else 1.0
    within = length(near[-1] * unit_m, estimate.metric)
    middle = length(float(np.median(near)) * unit_m, estimate.metric)
    typical = f", typically by {middle}" if len(near) > 1 else ""
    uneven = estimate.ground is not None and estimate.ground.relief_share > 0
    cause = ", likely because a match takes the ground for flat, and here it is not" if uneven else ""
    told = (
        f"{either(len(near), 'one', str(len(near)))} of them {either(len(near), 'shows', 'show')} the right "
        f"place but inexactly, off by {within} at most{typical}{cause}"
    )
    rest = (
        f"; {counted(far, 'lies', 'lie')} farther off than the map can be wrong: another place that looks "
        "alike, or a wrong fit"
    )
    return f"{text} ({told}{rest if far else ''})"


def _miss(rejection: Rejection, height_m: float, metric: bool) -> float | None:
    """Return by how much a match displaces the ground in its pictures, in heights of the camera; None where
    another check rejected it or the height is not known."""
    found = _MISS.search(rejection.figures)
    if rejection.check is not LinkCheck.GRAPH or found is None:
        return None
    if metric and not height_m > 0:  # a graph without pictures has no floor
        return None
    off, angle_rad = float(found[1]), np.radians(float(found[3]))
    if found[2] == "m" and metric:
        off /= height_m
    miss = float(np.hypot(off, angle_rad))
    return miss if np.isfinite(miss) else None
