"""The messages about a floor that repeats and about two motions in the pictures."""

from __future__ import annotations

import numpy as np

from backend.significance import SURE_SIGMAS
from slam.core.messages import Message, note, reason, warning
from slam.core.streams import Gps
from slam.mapping.floor_doubts import LIKELY_WRONG, FloorDoubts, RepeatingFloor, TwoMotions
from slam.mapping.map import Map

TOLD = 0.05
"""Expected number of wrong copies from which on a user has to know of them."""


def floor_doubt_messages(doubts: FloorDoubts, map_: Map, gps: Gps | None) -> list[Message]:
    """Return a message about each doubt."""
    repeating, both = doubts.repeating, doubts.two_motions
    lines = [_of_repeating(repeating, map_, gps)] if repeating else []
    return [*lines, *([_of_two(both, map_)] if both else [])]


def _of_repeating(found: RepeatingFloor, map_: Map, gps: Gps | None) -> Message:
    observations = map_.observations
    scale = map_.height_m[found.keyframes] / map_.camera.focal_px[0]
    period = float(np.nanmedian(found.period_px * scale))
    unit = "m" if map_.metric else "mean heights"
    fact = (
        f"the floor repeats every {period:.2g} {unit} in {len(found.keyframes)} of {found.looked_at} "
        "keyframes that were searched for it"
    )
    by = "the instruments" if observations.by_instruments else "the motion from picture to picture"
    if gps is not None and map_.georeferenced and SURE_SIGMAS * max(gps.noise_std_m[:2]) < 0.5 * period:
        # Fixes that contradict the pictures have a warning of their own.
        return note(fact, "the positions told which copy each picture shows")
    if found.wrong < TOLD:
        return note(fact, f"{by} told which copy each picture shows")
    line = warning(
        f"{fact}, and {by} may have led to a wrong copy ({found.wrong:.1g} expected): the pictures then "
        "agree with each other on a wrong motion",
        f"take pictures so often that the vehicle moves by less than {period / 4:.2g} {unit} between two, "
        "record velocity0 with attitude0 and sonar0, or lay out marks",
    )
    return line.as_reason() if found.wrong >= LIKELY_WRONG else line


def _of_two(found: TwoMotions, map_: Map) -> Message:
    observations = map_.observations
    begin_s, end_s = observations.camera_stamps_s[found.frames[[0, -1]]]
    by = " and the instruments agree with neither" if observations.by_instruments else ""
    return reason(
        f"two motions were seen in {len(found.frames)} of {observations.frames} pictures from "
        f"{begin_s:.1f} to {end_s:.1f} s{by}: the map follows one of them, the other one covers "
        f"{100 * found.share:.0f} % of what moves, and either may be the floor",
        "look at the mosaic: where it shows what moved, record velocity0 with attitude0 and sonar0, or leave "
        "these pictures out",
    )
