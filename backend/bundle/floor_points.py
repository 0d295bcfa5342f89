"""Initial floor points: intersections of viewing rays with the floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.bundle.lens import start_numbers
from backend.bundle.projections import undistorted
from backend.measurements import FloorTracks, PinholeModel

Array = NDArray[np.float64]

_MAX_RAY_SLOPE = -1e-3
"""Largest vertical component of a ray, so that one near the horizon still meets the floor."""


def intersect_floor(tracks: FloorTracks, camera: PinholeModel, w_T_c: Array) -> Array:
    """Return (t, 3) mean intersections of each track's rays with the floor z = 0; ``w_T_c`` is (n, 4, 4)."""
    pose = w_T_c[tracks.keyframe]
    xy = undistorted(start_numbers(camera), np.ascontiguousarray(tracks.pixel, dtype=float))
    ray = np.column_stack([xy, np.ones(len(xy))])
    ray = np.einsum("mab,mb->ma", pose[:, :3, :3], ray)
    hit = pose[:, :3, 3] - (pose[:, 2, 3] / np.minimum(ray[:, 2], _MAX_RAY_SLOPE))[:, None] * ray
    seen = np.bincount(tracks.track)
    return np.column_stack([np.bincount(tracks.track, hit[:, axis]) / seen for axis in range(3)])
