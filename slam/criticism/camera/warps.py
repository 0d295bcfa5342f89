"""Warps of pictures that no camera term of the catalogue describes.

Without them an unmodelled lens error passes for the most similar term: stretched columns, for example, pass
for a tilted camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]

LENS_MAP_PATTERN = "picture bent from place to place"
"""The last warp: the map of ``lens_distortion_map``, with its root mean square in px as the unit."""
_KINDS = (
    ("picture columns stretched against rows", 3e-3),
    ("picture sheared", 3e-3),
    ("picture turned", 1e-3),
    ("picture stretched ~ time", 3e-3),
    ("picture turned ~ time", 1e-3),
    ("picture shifted ~ time: columns", 1e-3),
    ("picture shifted ~ time: rows", 1e-3),
    (LENS_MAP_PATTERN, 0.03),
)
WARPS = tuple(name for name, _ in _KINDS)
TOLERANCE = np.array([std for _, std in _KINDS])
"""Largest apparent error of a healthy camera from features on small pictures, as for the camera's own terms.
"""
PAIRS = (("picture shifted ~ time: columns", "picture shifted ~ time: rows"),)
"""Pairs that are one warp, along columns and along rows."""


def warp(camera: Camera, pixel: Array, elapsed: Array) -> Array:
    """Return (m, 2, warps except ``LENS_MAP_PATTERN``) displacements in px of points (m, 2) for each unit of
    a warp.

    Units are tangents of angles. ``elapsed`` (m,) is the elapsed share of the flight minus one half. Stretch
    and shear change neither the size nor the rotation of a picture, so they correlate least with the focal
    length. An offset of the principal point is not among the warps: it resembles a tilted camera too much,
    and takes a quarter of such a tilt.
    """
    x, y = ((pixel - camera.center_px) / camera.focal_px).T
    none = np.zeros(len(x))
    along = (
        (x / 2, -y / 2), (y / 2, x / 2), (-y, x),
        (elapsed * x, elapsed * y), (-elapsed * y, elapsed * x), (elapsed, none), (none, elapsed),
    )  # fmt: skip
    off = np.stack([np.stack(both, axis=-1) for both in along], axis=-1)
    return np.asarray(off * np.array(camera.focal_px)[:, None])
