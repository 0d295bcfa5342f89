"""Recognises a vehicle that stood or hovered: all pictures show the same place."""

from __future__ import annotations

import numpy as np

from slam.core.flight import Flight
from slam.core.messages import Message, warning
from slam.core.units import length
from slam.mapping.map import Map


def one_place_warning(flight: Flight, map_: Map, min_overlap: float, by_metres: bool) -> Message | None:
    """Return the warning that nothing but one place is mapped; None where the vehicle moved.

    ``min_overlap``: overlap below which tracking creates a keyframe. The vehicle stayed at one place where no
    picture's centre on the floor leaves the first one's by such a step. A turn on the spot is no step.
    Photographs are taken one by one and are not judged.
    """
    placed = map_.w_T_b[map_.component == 0]
    if flight.all_keyframes or not len(placed):
        return None
    corners = np.array([map_.camera.footprint(w_T_b, map_.floor_z_m) for w_T_b in placed])
    centers = corners.mean(axis=1)
    shorter_side = float(np.linalg.norm(np.diff(corners[0], axis=0), axis=1).min())
    step, moved = (1 - min_overlap) * shorter_side, float(np.linalg.norm(centers - centers[0], axis=1).max())
    if not moved < step:
        return None
    return warning(
        f"the pictures show one place only: their centres move by {length(moved, by_metres)}, less than the "
        f"{length(step, by_metres)} of a keyframe",
        "the vehicle stood or hovered, or its camera froze, and nothing else is mapped",
        "fly over the ground that the map shall show",
    )
