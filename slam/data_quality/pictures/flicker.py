"""Flicker: bands of changing light in a picture, from lamps that flicker while a rolling shutter reads rows.

Exposure changes a whole picture, and a lens changes all pictures alike. Neither leaves a profile along rows
or columns between two pictures of the same floor.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.robust import robust_std
from slam.data_quality.finding import Remark
from slam.data_quality.pictures.cells import Cells, radius2

Array = NDArray[np.float64]

LINES = 12
"""Bins along a picture's rows and columns. Each is the median of its cells, which is robust against objects
in some of them."""
FEWEST_CELLS, FEWEST_LINES, FEWEST_PAIRS = 5, 5, 20
ROUNDS, CLIP = 5, 2.0
USUAL = 0.25
"""Quantile over the pairs: three of four have more, as an object or a reflection may be large in some."""
LEAST_FLICKER = 0.01
"""Root mean square of the logarithm of brightness from which flicker is reported. Healthy cameras, and
cameras with stains, vignetting, changing exposure or lamps in the floor, had at most 0.003; bands of 0.2 had
0.06."""


def flicker_of(camera: Camera, cells: Cells) -> float:
    """Return the change of brightness along rows or columns in most pairs; 0 for too few pairs."""
    outward = radius2(camera, cells.pixel_i) - radius2(camera, cells.pixel_j)
    columns = np.column_stack([np.ones(len(outward)), outward])
    lines = np.minimum((cells.pixel_i / camera.size_px * LINES).astype(np.int64), LINES - 1)
    found = []
    for run in cells.runs:
        left = _left(columns[run], cells.ratio[run])
        profiles = [_profile(lines[run, axis], left) for axis in (0, 1)]
        if min(map(len, profiles)) >= FEWEST_LINES:
            found.append(max(float(np.std(profile)) for profile in profiles))
    return float(np.quantile(found, USUAL)) if len(found) >= FEWEST_PAIRS else 0.0


def _left(columns: Array, y: Array) -> Array:
    """Return the residuals of a robust fit."""
    weight = np.ones(len(y))
    left = y
    for _ in range(ROUNDS):
        rows = columns * weight[:, None]
        left = y - columns @ np.linalg.lstsq(rows, y * weight, rcond=None)[0]
        weight = 1.0 / np.sqrt(1.0 + (left / (CLIP * (robust_std(left) + 1e-4))) ** 2)
    return left


def _profile(line: NDArray[np.int64], left: Array) -> Array:
    parts = [left[line == k] for k in range(LINES)]
    return np.array([np.median(part) for part in parts if len(part) >= FEWEST_CELLS])


def flicker_among(flickers: Iterable[float]) -> list[Remark]:
    """Return the greatest of the ``flickers`` of some flights, if any is notable: the brightness of such
    pictures is no evidence for other errors."""
    worst = max(flickers, default=0.0)
    if worst < LEAST_FLICKER:
        return []
    by = f"by {100 * worst:.0f} %, otherwise from picture to picture"
    return [Remark(f"picture brightness changes in bands, {by}", channel="pictures")]
