"""Pixels of control points that no mark of a point can be: counted otherwise, or of other pictures.

Programs count them from the lower edge, write the row before the column, or mark points in a picture that a
viewer has turned by its Exif orientation. A refinement that follows such pixels finds much noise in them, or
turns the map over: from below a floor, turned pictures show it as straight ones do from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from backend.bundle.refinement import Bundle
from backend.measurements import ControlPoint
from frontend.camera import Camera

Array = NDArray[np.float64]
Size = tuple[int, int]

_TURNED = "in pictures that a viewer turned by {}, as Exif's orientation tells it to"
_OTHERWISE: tuple[tuple[str, Callable[[Array, Array, Size], tuple[Array, Array]]], ...] = (
    ("upwards from the lower edge of the picture", lambda u, v, size: (u, size[1] - 1 - v)),
    ("from the right edge of the picture", lambda u, v, size: (size[0] - 1 - u, v)),
    ("with the row before the column", lambda u, v, size: (v, u)),
    (_TURNED.format("180 degrees"), lambda u, v, size: (size[0] - 1 - u, size[1] - 1 - v)),
    (_TURNED.format("90 degrees clockwise"), lambda u, v, size: (v, size[1] - 1 - u)),
    (_TURNED.format("90 degrees anticlockwise"), lambda u, v, size: (size[0] - 1 - v, u)),
)
"""How pixels may be counted instead, and column and row in the stored picture of such a pixel (u, v)."""
_CLEARLY = 0.5
"""Share of the scatter below which another count explains the pixels: by the right count, what is left is
tilt and relief, and by a wrong one, places anywhere in the picture."""
_MOST_MARK_RATIO = 0.01
"""Largest standard deviation of a mark over the longer side of its picture: on a screen of a thousand pixels,
a person hits within ten."""


def misread(bundle: Bundle, points: Sequence[ControlPoint], camera: Camera, w_T_b: Array) -> str:
    """Return what is wrong with the pixels of points that a refined map follows; empty if nothing is.

    ``w_T_b`` (m, 4, 4) are the level poses before, over the floor at z = 0.
    """
    points = [point for point in points if len(point.keyframe) > 1]
    mark_px = bundle.noise.marks * max((point.std_px for point in points), default=0.0)
    is_upright = np.median(bundle.w_T_b[:, 2, 2]) > 0
    if not points or (is_upright and mark_px <= _MOST_MARK_RATIO * max(camera.size_px)):
        return ""
    if otherwise := _counted_otherwise(points, camera, w_T_b):
        return f"their pixels fit the pictures only if they are counted {otherwise}"
    if not is_upright:
        return "their pixels turn the map upside down"
    return f"their pixels lie {mark_px:.0f} px off, more than marks in a picture do"


def _counted_otherwise(points: Sequence[ControlPoint], camera: Camera, w_T_b: Array) -> str:
    """Return by which other count all pictures show a point at one place of the floor; empty for none."""
    as_stored = _scatter([point.pixel for point in points], points, camera, w_T_b)
    found = [
        _scatter(
            [np.column_stack(count(p.pixel[:, 0], p.pixel[:, 1], camera.size_px)) for p in points],
            points,
            camera,
            w_T_b,
        )
        for _, count in _OTHERWISE
    ]
    best = int(np.argmin(found))
    return _OTHERWISE[best][0] if found[best] < _CLEARLY * as_stored else ""


def _scatter(pixels: Sequence[Array], points: Sequence[ControlPoint], camera: Camera, w_T_b: Array) -> float:
    """Return how far the pictures put a typical point from where they have it together; inf if unknown."""
    found = []
    for point, pixel in zip(points, pixels, strict=True):
        places = np.array(
            [
                camera.floor_points(w_T_b[k], uv[None], 0.0)[0][:2]
                for k, uv in zip(point.keyframe.tolist(), pixel, strict=True)
            ]
        )
        found.append(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    return float(np.median(np.nan_to_num(found, nan=np.inf)))
