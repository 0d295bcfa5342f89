"""Ways in which a picture may be warped that no term of the camera is.

Without them what a lens does that nobody thought of looks like the nearest thing that somebody did: pictures
whose columns are stretched made a camera that sits askew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]

BENT = "picture bent from place to place"
"""In px, root mean square: the lens's own map of ``dents``, which comes last."""
_KINDS = (
    ("picture columns stretched against rows", 3e-3),
    ("picture sheared", 3e-3),
    ("picture turned", 1e-3),
    ("picture stretched ~ time", 3e-3),
    ("picture turned ~ time", 1e-3),
    ("picture shifted ~ time: columns", 1e-3),
    ("picture shifted ~ time: rows", 1e-3),
    (BENT, 0.03),
)
WARPS = tuple(name for name, _ in _KINDS)
TOLERANCE = np.array([std for _, std in _KINDS])
"""Largest apparent error of a healthy camera from features on small pictures, as for the camera's own terms.
"""
PAIRS = (("picture shifted ~ time: columns", "picture shifted ~ time: rows"),)
"""Those that are one warp along columns and rows."""


def warp(camera: Camera, pixel: Array, elapsed: Array) -> Array:
    """(m, 2, warps but ``BENT``) px that points (m, 2) are off by for each unit of a warp.

    Units are tangents of angles, ``elapsed`` (m,) is the share of the flight that is over less a half.
    Stretched and sheared pictures are as large as before and not turned, so that these cost the focal length
    least. A picture off its middle, or bent off it, is not among them: it is too much like a camera that sits
    askew, and takes a quarter of that.
    """
    x, y = ((pixel - camera.center_px) / camera.focal_px).T
    none = np.zeros(len(x))
    along = (
        (x / 2, -y / 2), (y / 2, x / 2), (-y, x),
        (elapsed * x, elapsed * y), (-elapsed * y, elapsed * x), (elapsed, none), (none, elapsed),
    )  # fmt: skip
    off = np.stack([np.stack(both, axis=-1) for both in along], axis=-1)
    return np.asarray(off * np.array(camera.focal_px)[:, None])
