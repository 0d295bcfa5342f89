"""Parts of a map that no overlapping pictures connect."""

from __future__ import annotations

from backend.wording import either
from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.names import listed
from slam.mapping.map import Map


def parts_warning(flight: Flight, map_: Map) -> Message | None:
    """Return the line about a map in parts, which names the photographs of all but the largest; None for one
    part."""
    parts = int(map_.component.max(initial=-1)) + 1
    if parts < 2:
        return None
    sizes = ", ".join(str(int((map_.component == k).sum())) for k in range(parts))
    line = warning(
        f"the map is in {parts} parts ({sizes} keyframes) that no overlapping pictures connect: measure "
        "within a part only, or fly again with rows that overlap by half"
    )
    if flight.frames is None or not flight.all_keyframes:
        return line
    names = [flight.frames.names[k] for k in map_.observations.frame_index[map_.component > 0].tolist()]
    smaller = either(parts - 1, "the smaller part", "the smaller parts")
    # Fixes tell the place of a part, but pictures of the horizon fit them as well as those of the ground.
    aside = "no attitude tells that they look down: leave out those that do not" * (flight.attitude is None)
    return line.extended(f"look at {smaller}: {listed(names)}", aside)
