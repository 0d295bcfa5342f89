"""Points of the ground that a refined map has placed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FloorPoints:
    """Floor points relative to the keyframes that see them: they move as their keyframes are moved."""

    keyframe: NDArray[np.int64]
    """(t,) first keyframe that sees each point."""
    b_p_m: Array
    """(t, 3) place of the point in the body axes of that keyframe."""
    views: NDArray[np.int64]
    """(t,) number of keyframes whose view of the point was used."""
    std_m: Array
    """(t, 3) standard deviation of the place along the axes of the world, as
    `backend.bundle.accuracy.refined_points` defines it; NaN where it is not known."""

    def on_map(self, w_T_b: Array) -> Array:
        """Return (t, 3) the places of the points for poses (n, 4, 4); NaN for a keyframe without a pose."""
        pose = w_T_b[self.keyframe]
        return np.asarray(np.einsum("tab,tb->ta", pose[:, :3, :3], self.b_p_m) + pose[:, :3, 3])

    @staticmethod
    def joined(parts: Sequence[FloorPoints]) -> FloorPoints:
        """Return the points of all parts of a map."""
        return FloorPoints(
            np.concatenate([np.zeros(0, np.int64), *(part.keyframe for part in parts)]),
            np.concatenate([np.zeros((0, 3)), *(part.b_p_m for part in parts)]),
            np.concatenate([np.zeros(0, np.int64), *(part.views for part in parts)]),
            np.concatenate([np.zeros((0, 3)), *(part.std_m for part in parts)]),
        )
