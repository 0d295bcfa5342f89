"""Heights of what no two pictures show: from the lower ones around each hole."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from frontend.mosaic.surface import Surface

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

LOWER_PERCENT = 25
"""Percentile of the heights around a hole that fills it: half of the rim of a shadow is the roof above it."""
RIM_WIDTHS = 4
"""Length of the rim that counts for a cell, in widths of its hole. Beside a wall, the nearest rim of three
widths is ground for a quarter. All of the rim of a round hole counts: it is three widths long."""
NODES = 8
"""Nodes across the width of a hole at which its height is computed."""
MEDIAN_CELLS = 5
"""Side of the median filter, the largest that OpenCV has for heights."""
SPECK_CELLS = 50
"""Largest speck that is removed: 100 pixels of the matched pictures, as matching removes in each pair."""
_LEVELS = 16
"""Levels of height for one step."""


def without_specks(height_m: Float32, step_m: float) -> Float32:
    """Return the heights, NaN in small regions that differ by more than a step from all around them."""
    unknown = -(1 << 15)
    levels = np.clip(np.nan_to_num(height_m) * (_LEVELS / step_m), unknown + 1, -unknown - 1)
    image = np.where(np.isfinite(height_m), np.rint(levels), unknown).astype(np.int16)
    image = np.asarray(cv2.filterSpeckles(image, unknown, SPECK_CELLS, _LEVELS)[0])
    return np.where(image == unknown, np.float32(np.nan), height_m)


def filled(surface: Surface) -> Surface:
    """Return the surface with its unknown heights taken from the lower rim of each hole.

    What no two pictures see lies behind something higher, so its lower rim continues it. A quartile of the
    rim instead of its minimum withstands single heights that are wrong.
    """
    unknown = ~np.isfinite(surface.height_m)
    known = surface.height_m.copy()
    count, label, box, _ = cv2.connectedComponentsWithStats(unknown.astype(np.uint8), connectivity=8)
    beside = cv2.dilate(unknown.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool) & ~unknown
    depth = cv2.distanceTransform(np.pad(unknown, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    for hole in range(1, count):
        left, top, cols, rows, _ = box[hole]
        part = (slice(max(top - 1, 0), top + rows + 1), slice(max(left - 1, 0), left + cols + 1))
        known[part] = _filled(known[part], label[part] == hole, beside[part], depth[part])
    # Single wrong heights are removed; a median keeps edges.
    smooth = np.asarray(cv2.medianBlur(known, MEDIAN_CELLS))
    return replace(surface, height_m=np.where(surface.on_floor, known, smooth))


def _filled(height: Float32, hole: Mask, beside: Mask, depth: Float32) -> Float32:
    """Return the heights of the rectangle around a hole with the hole filled; 0 without a rim."""
    grown = cv2.dilate(hole.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    rim = np.argwhere(grown & beside)
    found, cells = height.copy(), np.argwhere(hole)
    if len(rim) == 0:
        found[hole] = 0.0
        return found
    width = 2 * float(depth[hole].max())
    count = int(RIM_WIDTHS * width)
    if count >= len(rim):
        found[hole] = np.percentile(height[rim[:, 0], rim[:, 1]], LOWER_PERCENT)
        return found
    step = max(1, round(width / NODES))
    node, of_cell = np.unique(cells // step, axis=0, return_inverse=True)
    # As the nodes, the rim is thinned out, in the order of its rows and columns.
    rim = rim[::step]
    nearest = cKDTree(rim).query((node + 0.5) * step, k=min(max(count // step, 1), len(rim)))[1]
    around = height[rim[:, 0], rim[:, 1]][nearest.reshape(len(node), -1)]
    found[hole] = np.percentile(around, LOWER_PERCENT, axis=1)[of_cell.ravel()]
    return found
