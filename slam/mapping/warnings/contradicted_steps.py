"""Report odometry that pairs of pictures contradict."""

from __future__ import annotations

from slam.core.flight import Flight
from slam.core.messages import Message
from slam.mapping.map import Map


def contradicted_step_warnings(flight: Flight, map_: Map) -> list[Message]:
    """Return a sentence for each step of odometry that pairs of pictures contradict by one displacement."""
    seen = map_.observations
    if not seen.contradicted_steps or flight.frames is None:
        return []
    names = flight.picture_names(flight.frames.stamps_s[seen.frame_index])
    return [step.sentence(lambda k: names[k]) for step in seen.contradicted_steps]
