"""The ground that a photograph shows, by its attitude and its view: whether it can be part of a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera import NADIR_B_T_C
from frontend.mosaic.view import MAX_OFF_NADIR

Array = NDArray[np.float64]

LEAST_SHARE = 0.5
"""Share of a picture that must show useful ground: the breakdown point of a robust fit to all that it shows.
Of made sets with a gimbal good to 2 degrees all photographs are placed up to an axis of 65 degrees, two of
three at 70, where half of any picture is useful, and none at 80."""
_NODES = 32
"""Nodes along either side of a picture: its share is known to less than 2 %."""


def why_no_ground(w_R_b: Array, size_px: tuple[int, int], relative_focal: float) -> str:
    """Return why a photograph of an attitude (3, 3) shows too little useful ground; empty where it is enough.

    Ground is useful as far off straight down as the mosaic draws it. ``relative_focal`` is the focal length
    over the longer side.
    """
    x, y = (np.linspace(-1, 1, _NODES) * side / max(size_px) / (2 * relative_focal) for side in size_px)
    ray = np.stack([*np.meshgrid(x, y), np.ones((_NODES, _NODES))], axis=-1)
    fall = -ray @ (w_R_b @ NADIR_B_T_C[:3, :3])[2] / np.linalg.norm(ray, axis=-1)
    if np.mean(fall > np.cos(MAX_OFF_NADIR)) >= LEAST_SHARE:
        return ""
    return (
        f"less than half of the picture shows ground within {np.degrees(MAX_OFF_NADIR):.0f} degrees of "
        "straight down by its tags, and the rest, up to the horizon, is too coarse; if the tags are wrong, "
        "remove their angles"
    )
