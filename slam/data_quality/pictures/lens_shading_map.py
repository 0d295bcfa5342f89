"""Map of brightness that stays fixed in the picture: dust and drops on the lens, an uneven sensor.

As the vehicle moves, the same floor point is seen through different places of the lens. The ratio of its
brightness gives a map of the lens. The radial part is left to vignetting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from frontend.camera import Camera
from frontend.robust import robust_std
from slam.data_quality.pictures.bilinear_weights import bilinear_weights, places
from slam.data_quality.pictures.cells import Cells, radius2

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PRIOR_STD = 0.1
"""Prior standard deviation of the logarithm of a node's transmission."""
CLIP, ROUNDS = 4.0, 10
"""Residuals are clipped at this many standard deviations, which become more robust from round to round. The
effect of a stain on a few cells is far beyond the noise of the others."""
LEAST_STD = 1e-3
"""Smallest standard deviation of the logarithm of brightness, of a cell and of a pair: pictures are rounded.
"""
BLOCK = 10
"""Length in pictures of the blocks that the other blocks predict: nearer pictures show the same points with
the same noise."""


@dataclass(frozen=True)
class LensShadingMap:
    """Logarithm of the lens transmission without the vignetting."""

    nodes: Array
    """(nodes,) map from all pictures of the flight."""
    predicted_by_others: Array
    """(m,) prediction for each cell, i minus j, from other pictures."""
    camera: Camera

    def at(self, pixel: Array) -> Array:
        """Return (n,) the map at undistorted pixels (n, 2)."""
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
    # A map of noise alone would pass for random exposure, so only the part that others confirm counts.
    share = float(
        np.clip(
            predicted_by_others @ cells.ratio / max(float(predicted_by_others @ predicted_by_others), 1e-12),
            0.0,
            1.0,
        )
    )
    return LensShadingMap(share * whole, predicted_by_others, camera)


def _fitted(rows: csr_array, y: Array, pair: Ints) -> Array:
    """Return (nodes,) the map by least squares. Cells of a pair have a common error (the exposures) and
    independent ones, whose variances are estimated too."""
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
        # Rows of a pair, each minus the share of their mean that the exposures explain.
        x_x = squares - mean.T @ ((count * (1.0 - kept**2))[:, None] * mean)
        x_left = rows.T @ left - mean.T @ (count * (1.0 - kept) * (of_pair @ left))
        prior = (alone / PRIOR_STD) ** 2
        map_ = map_ + np.linalg.solve(x_x + np.eye(nodes) * prior, x_left - map_ * prior)
    return map_


def _radial(camera: Camera) -> Array:
    """Return (nodes, 3) the columns of vignetting: even powers of the distance from the centre."""
    r2 = radius2(camera, places(camera))
    return np.column_stack([np.ones_like(r2), r2, r2**2])
