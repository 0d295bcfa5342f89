"""Photographs that a map takes to look straight down, although their pictures contradict it.

Without an attitude a part of the map that nothing but its fixes place is taken to look down. Photographs of
the horizon match each other and fit their fixes as well as those of the ground, so they would be drawn as
ground that is not there. But then they do not match the photographs whose ground they claim to show.
"""

from __future__ import annotations

import numpy as np

from frontend.camera import Camera
from slam.core.estimate import Estimate
from slam.core.flight import Flight
from slam.evaluation.loop_score import APART_S, TRUE_OVERLAP
from slam.evaluation.loops.reference import overlap_bounds

LOOK_ELSEWHERE = "other photographs of its place show other ground: it may not look down"
"""Reason not to draw a part."""
_CHANCE = 1e-3
"""Probability of failed matches of pictures of one ground up to which a part is drawn."""


def looking_elsewhere(estimate: Estimate, flight: Flight, camera: Camera) -> dict[int, str]:
    """Return the numbers of photographs that do not look down by their pictures, whole parts, with a reason.

    These are the parts at least half of whose photographs share ground with those of the largest part by
    their poses, even where the fixes err by their noise, and match none of them. How often photographs that
    share ground do not match is counted in the largest part. What they claim to show is on other photographs.
    """
    gps, component = flight.gps, estimate.component
    if gps is None or flight.attitude is not None or not flight.all_keyframes or component.max(initial=0) < 1:
        return {}
    placed = np.flatnonzero(component >= 0)
    footprints = np.stack(
        [camera.footprint(pose, estimate.floor_z_m) for pose in estimate.over_floor_T_b[placed]]
    )
    slack_m = float(np.hypot(*gps.noise_std_m[:2]))
    # Loops are pairs at some distance in time; photographs have no order.
    bounds = overlap_bounds(footprints, APART_S * np.arange(len(placed), dtype=float), slack_m)
    pairs = placed[[pair for pair, (least, _) in bounds.items() if least >= TRUE_OVERLAP]].reshape(-1, 2)
    parts = component[pairs]
    links = {frozenset((r.i, r.j)) for r in estimate.relative_poses}
    within = pairs[(parts == 0).all(axis=1)].tolist()
    matched = sum(frozenset(pair) in links for pair in within)
    fails = (len(within) - matched + 1) / (len(within) + 2)  # Laplace's rule of succession
    found: dict[int, str] = {}
    for part in range(1, int(component.max()) + 1):
        numbers = np.flatnonzero(component == part)
        across = pairs[(parts.min(axis=1) == 0) & (parts.max(axis=1) == part)]
        claimed = np.isin(numbers, across).sum()
        if 2 * claimed >= len(numbers) and fails**claimed < _CHANCE:
            found |= dict.fromkeys(numbers.tolist(), LOOK_ELSEWHERE)
    return found
