"""Warnings for flights whose camera froze, or whose pictures show nothing for a time."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from frontend.views import SAME_PICTURE
from slam.core.flight import Flight
from slam.mapping.front_end import Observations

NOTABLE_SHARE = 0.02
"""Share of pictures above which one reason to leave them out, or something moving, is reported."""
_HINTS = {
    SAME_PICTURE: "did the camera freeze? What it passed then is missing from the map",
    "too few features": "is the floor without texture or light there? What lies there is missing from the "
    "map, unless the drone passes it again; fly higher, or lay out marks",
}


def lost_picture_warnings(flight: Flight, observations: Observations) -> list[str]:
    """Return a line for each reason for which a flight's pictures were left out in numbers, with the longest
    time."""
    if flight.all_keyframes:  # photographs are named one by one
        return []
    frames: dict[str, list[int]] = defaultdict(list)
    for frame, reason in observations.dropped.items():
        frames[reason].append(frame)
    lines = []
    for reason, hint in _HINTS.items():
        left_out = np.sort(np.array(frames[reason], dtype=np.int64))
        if len(left_out) <= NOTABLE_SHARE * observations.frames:
            continue
        runs = np.split(left_out, np.flatnonzero(np.diff(left_out) > 1) + 1)
        longest = max(runs, key=len)
        begin_s, end_s = observations.camera_stamps_s[longest[[0, -1]]]
        lines.append(
            f"cam0: {len(left_out)} of {observations.frames} pictures are left out ({reason}), the longest "
            f"stretch from {begin_s:.1f} to {end_s:.1f} s: {hint}"
        )
    return lines
