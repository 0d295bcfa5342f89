"""What stays where it is in the picture: dust and drops on the lens, an uneven sensor.

The floor goes by underneath, so that the same point is seen through different places of the lens; how much
brighter it is in the one than in the other makes a map of the lens. What goes with the distance from the
middle is left to vignetting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

NODES = 7, 6
"""Of the map, along columns and rows; between them it is bilinear: a stain is no speck."""
PRIOR_STD = 0.1
"""Of the logarithm of the light that a node lets through."""
CLIP, ROUNDS = 4.0, 4
LEAST_STD = 1e-3
"""Of the logarithm of brightness, of a match and of a pair: pictures are rounded."""
BLOCK = 10
"""Pictures in a row that others foretell: those nearer show the same points with the same noise."""


@dataclass(frozen=True)
class Stain:
    """Logarithm of the light that each match's places let through, less that of a vignette."""

    at_i: Array
    """(m,) as the flight's pictures together have it."""
    at_j: Array
    foretold: Array
    """(m,) of i less j, as other pictures than these have it."""


def stain_of(
    camera: Camera, pixel_i: Array, pixel_j: Array, ratio: Array, usable: NDArray[np.bool_], pair: Ints,
    picture: Ints,
) -> Stain:  # fmt: skip
    """The map from matches (m): places, logarithm of the brightness in i over that in j, which pair each
    is of (0, 1, ..), and its earlier picture."""
    hats = [_hats(camera, pixel) for pixel in (pixel_i, pixel_j)]
    rows = hats[0] - hats[1]
    side = (picture // BLOCK) % 2
    radial = _radial(camera)

    def fitted(own: NDArray[np.bool_]) -> Array:
        free = _fitted(rows[own], ratio[own], np.unique(pair[own], return_inverse=True)[1])
        return np.asarray(free - radial @ np.linalg.lstsq(radial, free, rcond=None)[0])

    whole, halves = fitted(usable), [fitted(usable & (side != s)) for s in (0, 1)]
    foretold = np.where(side == 0, rows @ halves[0], rows @ halves[1])
    # A map of nothing but noise would make exposures restless: of it counts what other pictures confirm.
    along = foretold[usable]
    share = float(np.clip(along @ ratio[usable] / max(float(along @ along), 1e-12), 0.0, 1.0))
    return Stain(share * hats[0] @ whole, share * hats[1] @ whole, foretold)


def _fitted(rows: Array, y: Array, pair: Ints) -> Array:
    """(nodes,) least squares where matches of a pair err together, by the exposures of its pictures, and each
    by itself; how much they do is found on the way."""
    if len(y) == 0:
        return np.zeros(rows.shape[1])
    count = np.bincount(pair)
    table = np.column_stack([rows, y])
    mean = np.zeros((len(count), table.shape[1]))
    np.add.at(mean, pair, table)
    mean /= count[:, None]
    map_, apart = np.zeros(rows.shape[1]), table - mean[pair]
    for _ in range(ROUNDS):
        off, together = apart[:, -1] - apart[:, :-1] @ map_, mean[:, -1] - mean[:, :-1] @ map_
        alone = max(_spread(off), LEAST_STD)
        shared = np.maximum(_spread(together) ** 2 - alone**2 / count, LEAST_STD**2)
        kept = alone / np.sqrt(alone**2 + count * shared)
        left = np.clip(off, -CLIP * alone, CLIP * alone) + (kept * together)[pair]
        x = apart[:, :-1] + (kept[:, None] * mean[:, :-1])[pair]
        map_ = map_ + np.linalg.solve(
            x.T @ x + np.eye(len(map_)) * (alone / PRIOR_STD) ** 2,
            x.T @ left - map_ * (alone / PRIOR_STD) ** 2,
        )
    return map_


def _spread(x: Array) -> float:
    return 1.4826 * float(np.median(np.abs(x)))


def _hats(camera: Camera, pixel: Array) -> Array:
    """(m, nodes) bilinear weights."""
    place = []
    for axis, nodes in enumerate(NODES):
        at = np.clip(pixel[:, axis] / (camera.size_px[axis] - 1) * (nodes - 1), 0.0, nodes - 1.0)
        place.append(np.maximum(1.0 - np.abs(at[:, None] - np.arange(nodes)), 0.0))
    return np.asarray((place[0][:, :, None] * place[1][:, None, :]).reshape(len(pixel), -1))


def _radial(camera: Camera) -> Array:
    """(nodes, 3) what a vignette makes of the map: even powers of the distance from the middle."""
    axes = [np.linspace(0, camera.size_px[k] - 1, NODES[k]) - camera.center_px[k] for k in range(2)]
    r2 = (axes[0][:, None] ** 2 + axes[1] ** 2).ravel() / (np.hypot(*camera.size_px) / 2) ** 2
    return np.column_stack([np.ones_like(r2), r2, r2**2])
