"""Where floor points lie by the poses alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.measurements import FloorTracks, PinholeModel

Array = NDArray[np.float64]

_FLATTEST = -1e-3
"""Slope of a ray at least, downwards, so that one at the horizon still meets the floor somewhere."""


def intersect_floor(tracks: FloorTracks, camera: PinholeModel, w_T_c: Array) -> Array:
    """(t, 3) where the rays of each track meet the floor z = 0, on average; ``w_T_c`` (n, 4, 4)."""
    pose = w_T_c[tracks.keyframe]
    ray = np.column_stack([(tracks.pixel - camera.center_px) / camera.focal_px, np.ones(len(tracks.pixel))])
    ray = np.einsum("mab,mb->ma", pose[:, :3, :3], ray)
    hit = pose[:, :3, 3] - (pose[:, 2, 3] / np.minimum(ray[:, 2], _FLATTEST))[:, None] * ray
    seen = np.bincount(tracks.track)
    return np.column_stack([np.bincount(tracks.track, hit[:, axis]) / seen for axis in range(3)])
