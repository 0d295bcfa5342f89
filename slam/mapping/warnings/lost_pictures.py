"""Warnings for flights whose camera froze, or whose pictures show nothing for a time."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from backend.wording import either
from frontend.keyframes import TOO_FEW
from frontend.views import SAME_PICTURE
from slam.core.flight import Flight
from slam.core.lost_pictures import BARE_GROUND, NOTABLE_SHARE
from slam.core.messages import Message, about
from slam.mapping.front_end import Observations

_HINTS = {
    SAME_PICTURE: ("cam0", ("did the camera freeze? What it passed then is missing from the map",)),
    TOO_FEW: (
        BARE_GROUND,
        (
            "is the floor without texture or light there? What lies there is missing from the map, unless "
            "other pictures show it",
            "if that ground matters, fly over it again higher, or lay out marks",
        ),
    ),
}
"""Reason -> what is at fault, an instrument or the ground, and the clauses of what to ask."""

_MOST_STRETCHES, _NOTABLE_STRETCH = 3, 0.5
"""Number of stretches that are named, and their least length over that of the longest."""


def lost_picture_warnings(flight: Flight, observations: Observations) -> list[Message]:
    """Return a line for each reason for which a flight's pictures were left out in numbers, with times."""
    if flight.all_keyframes:  # photographs are named one by one
        return []
    frames: dict[str, list[int]] = defaultdict(list)
    for frame, reason in observations.dropped.items():
        frames[reason.partition(", ")[0]].append(frame)  # what was tried beside is no reason of its own
    lines = list[Message]()
    for reason, (at_fault, (hint, *further)) in _HINTS.items():
        left_out = np.sort(np.array(frames[reason], dtype=np.int64))
        if len(left_out) <= NOTABLE_SHARE * observations.frames:
            continue
        runs = np.split(left_out, np.flatnonzero(np.diff(left_out) > 1) + 1)
        longest = sorted(runs, key=len, reverse=True)[:_MOST_STRETCHES]
        notable = [run for run in longest if len(run) >= _NOTABLE_STRETCH * len(longest[0])]
        times = [
            observations.camera_stamps_s[run[[0, -1]]] for run in sorted(notable, key=lambda run: run[0])
        ]
        stretches = " and ".join(f"from {begin_s:.1f} to {end_s:.1f} s" for begin_s, end_s in times)
        lines.append(
            about(
                at_fault,
                f"{len(left_out)} of {observations.frames} pictures {either(len(left_out), 'is', 'are')} "
                f"left out ({reason}), the longest stretch{'es' * (len(times) > 1)} {stretches}: {hint}",
                *further,
            )
        )
    return lines
