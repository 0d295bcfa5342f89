"""Bilinear interpolation on a grid of nodes over the picture, for maps of lens errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from frontend.camera import Camera

Array = NDArray[np.float64]

NODES = 13, 11
"""Nodes along columns and rows. Stains and drops on a lens are wider than the distance between nodes."""
COUNT = NODES[0] * NODES[1]


def bilinear_weights(camera: Camera, pixel: Array) -> csr_array:
    """Return the (m, nodes) bilinear weights of undistorted pixels (m, 2)."""
    low, part = [], []
    for axis, nodes in enumerate(NODES):
        at = np.clip(pixel[:, axis] / (camera.size_px[axis] - 1) * (nodes - 1), 0.0, nodes - 1.0)
        low.append(np.minimum(at.astype(np.int64), nodes - 2))
        part.append(at - low[-1])
    columns, weights = [], []
    for right in (0, 1):
        for down in (0, 1):
            columns.append((low[0] + right) * NODES[1] + low[1] + down)
            weights.append(np.abs(1 - right - part[0]) * np.abs(1 - down - part[1]))
    shape = (len(pixel), COUNT)
    index = np.column_stack(columns).ravel()
    return csr_array((np.column_stack(weights).ravel(), index, 4 * np.arange(len(pixel) + 1)), shape=shape)


def places(camera: Camera) -> Array:
    """Return (nodes, 2) the pixels of the nodes."""
    axes = [np.linspace(0, camera.size_px[k] - 1, NODES[k]) for k in range(2)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
