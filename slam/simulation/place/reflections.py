"""Specular highlights: reflections of ceiling lamps in a glossy floor.

The reflection of a lamp at height h appears in the direction of its mirror image at -h. So it moves over the
floor with the camera, at h / (h + z) of its speed.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

LAMP_HEIGHT_M = 4.0
LAMP_SPACING_M = 2.5
REACH_M = 8.0
"""Horizontal range of the lamps that a downward camera can see."""
SPREAD_RAD = 0.05
"""Standard deviation of the spot, because the floor is polished but no mirror."""


def mirrored_lamps(w_p: Array) -> Array:
    """Return the mirror images (n, 3) of the lamps around a position; the lamps form a grid on the
    ceiling."""
    first, last = (
        np.ceil((w_p[:2] - REACH_M) / LAMP_SPACING_M),
        np.floor((w_p[:2] + REACH_M) / LAMP_SPACING_M),
    )
    x, y = (LAMP_SPACING_M * np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    at = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    return np.column_stack([at, np.full(len(at), -LAMP_HEIGHT_M)])


def add_reflection(
    samples: Image, camera: Camera, fineness: int, w_R_c: Array, w_t_c: Array, strength: float
) -> None:
    """Add the spots seen from one pose to ``samples`` (h, w, 3), in place.

    A pixel has ``fineness`` samples along each side.
    """
    c_p = (mirrored_lamps(w_t_c) - w_t_c) @ w_R_c
    spread_px = SPREAD_RAD * camera.focal_px[0]
    reach = int(np.ceil(3 * spread_px * fineness))
    height, width = samples.shape[:2]
    # The distortion of a wide angle may fold points far outside back into the picture.
    ahead = c_p[c_p[:, 2] > np.hypot(c_p[:, 0], c_p[:, 1])]
    for u, v in (camera.project(ahead) + 0.5) * fineness - 0.5:
        c0, c1 = max(0, round(u) - reach), min(width, round(u) + reach + 1)
        r0, r1 = max(0, round(v) - reach), min(height, round(v) + reach + 1)
        if c0 >= c1 or r0 >= r1:
            continue
        x = np.exp(-0.5 * ((np.arange(c0, c1) - u) / (spread_px * fineness)) ** 2)
        y = np.exp(-0.5 * ((np.arange(r0, r1) - v) / (spread_px * fineness)) ** 2)
        spot = np.minimum(255 * strength * y[:, None] * x[None], 255).astype(np.uint8)
        samples[r0:r1, c0:c1] = cv2.add(samples[r0:r1, c0:c1], cv2.merge([spot, spot, spot]))
