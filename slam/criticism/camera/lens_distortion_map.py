"""Map of local distortions of the lens, such as drops and scratches.

A homography leads from picture to picture, whatever the scale, the tilt or the stretch of a lens. What it
does not explain, and what stays where it is in the picture while the floor goes by, is a map of the lens.
What goes with the distance from the middle is left to the radial distortion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron

from frontend.camera import Camera
from frontend.homography import jacobian
from frontend.robust import robust_std
from slam.criticism.camera.bilinear_weights import COUNT, bilinear_weights, places
from slam.criticism.camera.cells import radius2

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PRIOR_PX = 0.3
"""That a node is off by, against the noise of its points."""
CLIP, ROUNDS = 3.0, 8
"""Residuals are clipped at so many deviations of most of them: some matches are of other things."""
BLOCK = 40
"""About so many pictures in a row are foretold by others: those nearer show the same points with the same
noise."""
LEAST_PX = 0.02
"""Nodes that are off by less are not off, for what else the field may be a part of."""
NOTABLE_PX = 0.1
"""Root mean square: a drop bends by 0.3 and more; healthy lenses, lamps and things that move leave 0.04."""
GAUGE_ROUNDS = 30


@dataclass(frozen=True)
class LensDistortionMap:
    """Displacement of points in each half of a flight's pictures, relative to a lens of the catalogue."""

    camera: Camera
    pictures: int
    """How many the flight has."""
    halves: Array
    """(2, nodes, 2) px, a root mean square of 1 over the points of both."""
    size_px: float
    """The root mean square that they had."""

    @property
    def notable(self) -> bool:
        """Whether something sits on the lens: it shines and moves otherwise than the floor, as lamps do."""
        return self.size_px > NOTABLE_PX

    def predicted_by_others(self, pixel: Array, earlier: Ints) -> Array:
        """(m, 2) px that points of pairs are off by, as pictures not near the ``earlier`` ones say."""
        weights, side = bilinear_weights(self.camera, pixel), _block(earlier, self.pictures)[:, None] % 2
        return np.asarray(np.where(side == 0, weights @ self.halves[1], weights @ self.halves[0]))


@dataclass(frozen=True)
class PairMatches:
    """Matches of pairs of pictures, those of a pair in a row, with what leads from j to i."""

    pair: Ints
    """(m,) number of the pair, from 0."""
    earlier: Ints
    later: Ints
    pixel_i: Array
    pixel_j: Array
    std_px: Array
    i_H_j: Array
    """(pairs, 3, 3)."""

    def __getitem__(self, which: NDArray[np.bool_]) -> PairMatches:
        kept, pair = np.unique(self.pair[which], return_inverse=True)
        return PairMatches(
            pair=pair,
            earlier=self.earlier[which],
            later=self.later[which],
            pixel_i=self.pixel_i[which],
            pixel_j=self.pixel_j[which],
            std_px=self.std_px[which],
            i_H_j=self.i_H_j[kept],
        )


def lens_distortion_map(camera: Camera, pictures: int, matches: PairMatches) -> LensDistortionMap:
    """Return the distortion map of a flight's lens, separately for both halves of the pictures."""
    block, other = (_block(at, pictures) for at in (matches.earlier, matches.later))
    sides = [(block == other) & (block % 2 == side) for side in (0, 1)]
    halves = np.stack([_gauged(camera, _fitted(camera, matches[side])) for side in sides])
    seen = bilinear_weights(camera, matches.pixel_i)
    size_px = float(np.sqrt(np.mean([(seen @ half) ** 2 for half in halves])))
    return LensDistortionMap(camera, pictures, halves / max(size_px, 1e-9), size_px)


def _block(picture: Ints, pictures: int) -> Ints:
    """The number of the block that each of a flight's pictures is in; there are as many even as odd ones."""
    blocks = 2 * max(round(pictures / (2 * BLOCK)), 1)
    return picture * blocks // pictures


def _fitted(camera: Camera, matches: PairMatches) -> Array:
    """(nodes, 2) px: least squares beside a homography of each pair, far-off points pulled in."""
    if len(matches.pair) == 0:
        return np.zeros((COUNT, 2))
    carried, by_entry, by_pixel = _carried(matches)
    weight = np.repeat(1.0 / matches.std_px, 2)
    y = (matches.pixel_i - carried).ravel() * weight
    at_i, at_j = (
        kron(bilinear_weights(camera, pixel), np.eye(2)) for pixel in (matches.pixel_i, matches.pixel_j)
    )
    rows = csr_array((at_i - _blocks(by_pixel) @ at_j).multiply(weight[:, None]))
    Q = _orthonormal(by_entry * weight.reshape(-1, 2, 1), matches.pair)
    across = np.asarray((Q.T @ rows).todense())
    squares = np.asarray((rows.T @ rows).todense()) - across.T @ across
    map_ = np.zeros(2 * COUNT)
    for _ in range(ROUNDS):
        off = y - rows @ map_
        off -= Q @ (Q.T @ off)
        noise = max(robust_std(off), 1e-6)
        left = np.clip(off, -CLIP * noise, CLIP * noise)
        left -= Q @ (Q.T @ left)
        prior = (noise / PRIOR_PX) ** 2
        step = rows.T @ left - prior * map_
        map_ = map_ + np.linalg.solve(squares + prior * np.eye(len(map_)), step)
    return map_.reshape(COUNT, 2)


def _carried(matches: PairMatches) -> tuple[Array, Array, Array]:
    """(m, 2) pixels j in picture i, with their derivatives by the entries of the pair's homography (m, 2, 8)
    and by the pixels (m, 2, 2)."""
    H = matches.i_H_j[matches.pair]
    seen = np.column_stack([matches.pixel_j, np.ones(len(H))])
    u = np.einsum("mab,mb->ma", H, seen)
    p, first = u[:, :2] / u[:, 2:], seen / u[:, 2:]
    by_entry = jacobian(p.T, first.T).reshape(-1, 2, 8)
    by_pixel = (H[:, :2, :2] - p[:, :, None] * H[:, 2:, :2]) / u[:, 2, None, None]
    return p, by_entry, by_pixel


def _blocks(by_pixel: Array) -> csr_array:
    """(2 m, 2 m) of m blocks."""
    m = len(by_pixel)
    column = np.repeat(2 * np.arange(m), 4).reshape(m, 2, 2) + np.arange(2)
    return csr_array((by_pixel.ravel(), column.ravel(), 2 * np.arange(2 * m + 1)), shape=(2 * m, 2 * m))


def _orthonormal(by_entry: Array, pair: Ints) -> csr_array:
    """(2 m, 8 pairs) what the homographies of the pairs can explain, each pair's columns orthonormal."""
    m, pairs = len(pair), int(pair[-1]) + 1
    of_pair = csr_array((np.ones(m), (pair, np.arange(m))), shape=(pairs, m))
    squares = (of_pair @ np.matmul(by_entry.transpose(0, 2, 1), by_entry).reshape(m, 64)).reshape(-1, 8, 8)
    size = np.sqrt(np.einsum("paa->pa", squares))
    values, vectors = np.linalg.eigh(squares / (size[:, :, None] * size[:, None, :]))
    back = (
        vectors / size[:, :, None] * np.where(values > 1e-9, np.maximum(values, 1e-9) ** -0.5, 0.0)[:, None]
    )
    own = np.matmul(by_entry, back[pair])
    column = np.repeat(8 * pair, 16).reshape(m, 2, 8) + np.arange(8)
    start = 8 * np.arange(2 * m + 1)
    return csr_array((own.ravel(), column.ravel(), start), shape=(2 * m, 8 * pairs))


def _gauged(camera: Camera, field: Array) -> Array:
    """The field (nodes, 2) less what the terms of a lens and homographies make of it, as most nodes have it.

    A homography of all pictures alike cannot be seen in any pair; a dent is what most of the picture has not.
    """
    x, y = ((places(camera) - camera.center_px) / camera.focal_px).T
    r2, none, one = radius2(camera, places(camera)), np.zeros_like(x), np.ones_like(x)
    along = (
        (x, none), (y, none), (one, none), (none, x), (none, y), (none, one), (x * x, x * y), (x * y, y * y),
        (x * r2, y * r2), (x * r2**2, y * r2**2),
    )  # fmt: skip
    common = np.stack([np.concatenate(both) for both in along], axis=-1)
    flat = field.T.ravel()
    share = np.zeros(common.shape[1])
    for _ in range(GAUGE_ROUNDS):
        left = np.hypot(*(flat - common @ share).reshape(2, -1))
        weight = np.tile(np.maximum(left, LEAST_PX) ** -0.5, 2)
        share = np.linalg.lstsq(weight[:, None] * common, weight * flat, rcond=None)[0]
    return np.asarray((flat - common @ share).reshape(2, -1).T)
