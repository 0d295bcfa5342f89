"""Map of the brightness that stays fixed in the picture: dust and drops on the lens, an uneven sensor.

The floor goes by underneath, so that the same point is seen through different places of the lens; how much
brighter it is in the one than in the other makes a map of the lens. What goes with the distance from the
middle is left to vignetting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from frontend.camera import Camera
from frontend.robust import robust_std
from slam.criticism.camera.bilinear_weights import bilinear_weights, places
from slam.criticism.camera.cells import Cells, radius2

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PRIOR_STD = 0.1
"""Prior deviation of the logarithm of a node's transmission."""
CLIP, ROUNDS = 4.0, 10
"""Residuals are clipped at so many deviations, at first of all and then ever nearer to those of most: what a
stain makes of a few cells is far beyond the noise of the others."""
LEAST_STD = 1e-3
"""Smallest standard deviation of the logarithm of brightness, of a cell and of a pair: pictures are rounded.
"""
BLOCK = 10
"""Pictures in a row that others foretell: those nearer show the same points with the same noise."""


@dataclass(frozen=True)
class LensShadingMap:
    """Logarithm of the light that places let through, less that of a vignette."""

    nodes: Array
    """As the flight's pictures together have it, ..."""
    predicted_by_others: Array
    """(m,) ... and of each cell, i less j, as other pictures than these have it."""
    camera: Camera

    def at(self, pixel: Array) -> Array:
        """(n,) of undistorted pixels (n, 2)."""
        return np.asarray(bilinear_weights(self.camera, pixel) @ self.nodes)


def lens_shading_map(camera: Camera, cells: Cells) -> LensShadingMap:
    """Return the shading map of a flight's lens."""
    rows = bilinear_weights(camera, cells.pixel_i) - bilinear_weights(camera, cells.pixel_j)
    count = [run.stop - run.start for run in cells.runs]
    pair = np.repeat(np.arange(len(count)), count)
    side = (cells.earlier // BLOCK) % 2
    radial = _radial(camera)

    def fitted(own: NDArray[np.bool_]) -> Array:
        free = _fitted(rows[own], cells.ratio[own], np.unique(pair[own], return_inverse=True)[1])
        return np.asarray(free - radial @ np.linalg.lstsq(radial, free, rcond=None)[0])

    whole, halves = fitted(np.full(len(pair), True)), [fitted(side != s) for s in (0, 1)]
    predicted_by_others = np.where(side == 0, rows @ halves[0], rows @ halves[1])
    # A map of nothing but noise would make exposures restless: of it counts what other pictures confirm.
    share = float(
        np.clip(
            predicted_by_others @ cells.ratio / max(float(predicted_by_others @ predicted_by_others), 1e-12),
            0.0,
            1.0,
        )
    )
    return LensShadingMap(share * whole, predicted_by_others, camera)


def _fitted(rows: csr_array, y: Array, pair: Ints) -> Array:
    """(nodes,) least squares where cells of a pair err together, by the exposures of its pictures, and each
    by itself; how much they do is found on the way."""
    nodes = rows.shape[1]
    if len(y) == 0:
        return np.zeros(nodes)
    count = np.bincount(pair)
    of_pair = csr_array((1.0 / count[pair], pair, np.arange(len(y) + 1)), shape=(len(y), len(count))).T
    mean = np.asarray((of_pair @ rows).todense())
    squares = np.asarray((rows.T @ rows).todense())
    map_, all_std = np.zeros(nodes), float(np.std(y))
    for k in range(ROUNDS):
        off = y - rows @ map_
        together = of_pair @ off
        off = off - together[pair]
        alone = max(robust_std(off), LEAST_STD)
        shared = np.maximum(robust_std(together) ** 2 - alone**2 / count, LEAST_STD**2)
        kept = alone / np.sqrt(alone**2 + count * shared)
        most = CLIP * max(alone, all_std / 2**k)
        left = np.clip(off, -most, most) + (kept * together)[pair]
        # Rows of a pair, each less the share of their mean that its exposures may be.
        x_x = squares - mean.T @ ((count * (1.0 - kept**2))[:, None] * mean)
        x_left = rows.T @ left - mean.T @ (count * (1.0 - kept) * (of_pair @ left))
        prior = (alone / PRIOR_STD) ** 2
        map_ = map_ + np.linalg.solve(x_x + np.eye(nodes) * prior, x_left - map_ * prior)
    return map_


def _radial(camera: Camera) -> Array:
    """(nodes, 3) what a vignette makes of the map: even powers of the distance from the middle."""
    r2 = radius2(camera, places(camera))
    return np.column_stack([np.ones_like(r2), r2, r2**2])
