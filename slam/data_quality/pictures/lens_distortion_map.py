"""Map of local distortions of the lens, such as drops and scratches.

A homography relates two pictures of the floor for any scale, tilt or stretch of the lens. Residuals that stay
at one place of the picture while the floor moves form a map of the lens. Its radial part is left to the
radial distortion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron

from frontend.camera import Camera
from frontend.homography import jacobian
from frontend.robust import robust_std
from slam.data_quality.pictures.bilinear_weights import COUNT, bilinear_weights, places
from slam.data_quality.pictures.cells import radius2

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

PRIOR_PX = 0.3
"""Prior standard deviation of a node's displacement, in px."""
CLIP, ROUNDS = 3.0, 8
"""Residuals are clipped at this many robust standard deviations, as some matches show other objects."""
BLOCK = 40
"""Length in pictures of the blocks that the other blocks predict: nearer pictures show the same points with
the same noise."""
LEAST_PX = 0.02
"""Displacement in px below which a node counts as undistorted when the lens terms are removed."""
NOTABLE_PX = 0.1
"""Root mean square in px from which a map counts: a drop has 0.3 or more; healthy lenses, lamps and moving
objects leave 0.04."""
GAUGE_ROUNDS = 30


@dataclass(frozen=True)
class LensDistortionMap:
    """Displacement of points in each half of a flight's pictures, relative to a lens of the catalogue."""

    camera: Camera
    pictures: int
    """Number of pictures of the flight."""
    halves: Array
    """(2, nodes, 2) displacements, scaled to a root mean square of 1 over the points of both halves."""
    size_px: float
    """Root mean square of the displacements before scaling, in px."""

    @property
    def notable(self) -> bool:
        """Whether there is an object on the lens. It shines and moves differently from the floor, as lamps
        do."""
        return self.size_px > NOTABLE_PX

    def predicted_by_others(self, pixel: Array, earlier: Ints) -> Array:
        """Return (m, 2) the displacements of points in units of the map, from pictures not near ``earlier``
        (m,)."""
        weights, side = bilinear_weights(self.camera, pixel), _block(earlier, self.pictures)[:, None] % 2
        return np.asarray(np.where(side == 0, weights @ self.halves[1], weights @ self.halves[0]))


@dataclass(frozen=True)
class PairMatches:
    """Matches of pairs of pictures, sorted by pair, with the homography from j to i."""

    pair: Ints
    """(m,) index of the pair."""
    earlier: Ints
    later: Ints
    pixel_i: Array
    pixel_j: Array
    std_px: Array
    i_H_j: Array
    """(pairs, 3, 3) homographies."""

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
    """Return the block index of each of a flight's pictures; even and odd blocks are equally many."""
    blocks = 2 * max(round(pictures / (2 * BLOCK)), 1)
    return picture * blocks // pictures


def _fitted(camera: Camera, matches: PairMatches) -> Array:
    """Return (nodes, 2) displacements in px by least squares beside a homography of each pair, with outliers
    clipped."""
    if len(matches.pair) == 0:
        return np.zeros((COUNT, 2))
    transferred, by_entry, by_pixel = _transferred(matches)
    weight = np.repeat(1.0 / matches.std_px, 2)
    y = (matches.pixel_i - transferred).ravel() * weight
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


def _transferred(matches: PairMatches) -> tuple[Array, Array, Array]:
    """Return (m, 2) pixels j transferred into picture i, with their derivatives in the pair's homography
    (m, 2, 8) and in the pixels (m, 2, 2)."""
    H = matches.i_H_j[matches.pair]
    seen = np.column_stack([matches.pixel_j, np.ones(len(H))])
    u = np.einsum("mab,mb->ma", H, seen)
    p, first = u[:, :2] / u[:, 2:], seen / u[:, 2:]
    by_entry = jacobian(p.T, first.T).reshape(-1, 2, 8)
    by_pixel = (H[:, :2, :2] - p[:, :, None] * H[:, 2:, :2]) / u[:, 2, None, None]
    return p, by_entry, by_pixel


def _blocks(by_pixel: Array) -> csr_array:
    """Return the (2 m, 2 m) block-diagonal matrix of m blocks."""
    m = len(by_pixel)
    column = np.repeat(2 * np.arange(m), 4).reshape(m, 2, 2) + np.arange(2)
    return csr_array((by_pixel.ravel(), column.ravel(), 2 * np.arange(2 * m + 1)), shape=(2 * m, 2 * m))


def _orthonormal(by_entry: Array, pair: Ints) -> csr_array:
    """Return (2 m, 8 pairs) the derivatives in the homographies, with orthonormal columns for each pair."""
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
    """Return the field (nodes, 2) without the part that lens terms and homographies explain, by a robust fit.

    No pair shows a homography that all pictures share. A local distortion covers less than half of the
    picture.
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
