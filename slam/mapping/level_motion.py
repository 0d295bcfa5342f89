"""Motion of poses over a level floor that keeps their tilts and heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def moved_level(w_T_b: Array, yaw_rad: float, place: Array) -> Array:
    """Return level poses (n, 4, 4), turned and shifted so that the first has a heading and a place (2,)."""
    moved, turn = w_T_b.copy(), np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw_rad - heading_of(w_T_b[0])).as_matrix()
    moved[:, :2, 3] -= w_T_b[0, :2, 3]
    moved = turn @ moved
    moved[:, :2, 3] += place
    return np.asarray(moved)


def heading_of(w_T_b: Array) -> float:
    """Return the direction of the first axis of a pose (4, 4) in the plane, in radians."""
    return float(np.arctan2(w_T_b[1, 0], w_T_b[0, 0]))
