"""Pictures that should have a pose and have none, by name."""

from __future__ import annotations

from backend.wording import counted
from slam.core.flight import Flight
from slam.core.messages import Message, parsed
from slam.core.names import listed
from slam.mapping.map import Map

ALONE = "could not be joined to any other picture"
"""Reason of a keyframe that no edge connects."""


def pictures_not_placed(flight: Flight, map_: Map) -> dict[str, str]:
    """Return the names of keyframes and photographs without a pose, with the reasons."""
    assert flight.frames is not None
    observations = map_.observations
    # Only of photographs each one is meant to be on the map.
    dropped = observations.dropped if flight.all_keyframes else {}
    lost = observations.frame_index[map_.component < 0]
    reasons = {**dropped, **dict.fromkeys(lost.tolist(), ALONE)}
    return {flight.frames.names[k]: reasons[k] for k in sorted(reasons)}


def not_placed_warnings(not_placed: dict[str, str]) -> list[Message]:
    """Return one line for each reason, except that of keyframes without edges, which the status contains."""
    names: dict[str, list[str]] = {}
    for name, reason in not_placed.items():
        if reason != ALONE:
            names.setdefault(reason, []).append(name)
    return [
        parsed(f"{counted(len(of), 'photograph')} not placed: {reason} ({listed(of)})")
        for reason, of in names.items()
    ]
