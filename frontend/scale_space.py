"""Keypoints of a picture: extrema of differences of Gaussians in the scale space of the doubled picture.

They are those of OpenCV's SIFT, which takes twice the time for large pictures and 1.5 times that for small
ones: whole pictures are filtered and compared here in integers of 16 bits, and all keypoints refined at once.
Source: Lowe 2004, sections 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
Short = NDArray[np.int16]

LAYERS = 3
"""Layers of an octave that keypoints are found in, as in the source."""
PICTURES = LAYERS + 3
"""Blurred pictures of an octave: a difference above and below each of those layers."""
SIGMA_PX, CAMERA_SIGMA_PX = 1.6, 0.5
"""Blur of the first picture of an octave, and of the camera's pictures, as in the source."""
CONTRAST = 0.01
"""Least contrast of a keypoint, as a share of white, times ``LAYERS``. Dark floors need a low one."""
EDGE_RATIO = 12.0
"""Largest ratio of the curvatures across and along an edge."""
FRACTION = 64
"""Pictures are integers of 16 bits in units of 1 / 64 grey level: differences of white and black just fit."""
WHITE = 255
SMALLEST_SIDE_PX = 16
"""Smallest side of an octave."""
BORDER_PX = 5
"""Width of the border of an octave in which no keypoints are sought, as in OpenCV."""
STRIP_ROWS = 96
"""Rows of an octave that are searched at a time: their arrays stay in the cache of a core."""
STEPS = 5
"""Most steps to a neighbouring pixel or layer while a position is refined, as in OpenCV."""

_BLUR_PX = SIGMA_PX * 2.0 ** (np.arange(PICTURES) / LAYERS)
_SQUARE = np.ones((3, 3), np.uint8)
_ALONG = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
_ACROSS = np.array(
    [(a, b, 0) for a in (1, -1) for b in (1, -1)]
    + [(a, 0, b) for a in (1, -1) for b in (1, -1)]
    + [(0, a, b) for a in (1, -1) for b in (1, -1)]
)
_NEIGHBOURS = np.concatenate([np.zeros((1, 3), int), _ALONG, _ACROSS])
"""(19, 3) steps in layer, row and column from a pixel to those that a quadratic fit takes."""


@dataclass(frozen=True)
class Keypoints:
    """Keypoints of a picture."""

    octave: Ints
    """(n,) 0 is the doubled picture; each next one has half the pixels along each side."""
    layer: Ints
    """(n,) 1 to ``LAYERS``."""
    at_px: Array
    """(n, 2) x and y in pixels of the octave."""
    sigma_px: Array
    """(n,) scale in pixels of the octave."""
    response: Array
    """(n,) absolute difference of Gaussians, in grey levels."""

    def __len__(self) -> int:
        return len(self.octave)

    def __getitem__(self, which: Ints) -> Keypoints:
        return Keypoints(
            self.octave[which], self.layer[which], self.at_px[which], self.sigma_px[which],
            self.response[which],
        )  # fmt: skip

    @property
    def pixel(self) -> Array:
        """(n, 2) positions in the picture. A coarser octave takes every second pixel, beginning at the
        first; that of the doubled picture is at -1/4 px."""
        return np.asarray(self.at_px * 2.0 ** (self.octave[:, None] - 1) - 0.25)

    @property
    def size_px(self) -> Array:
        """(n,) diameters in the picture, as OpenCV has them."""
        return np.asarray(self.sigma_px * 2.0**self.octave)


@dataclass(frozen=True)
class ScaleSpace:
    """Blurred pictures of all octaves, and their differences."""

    blurred: list[list[Short]]
    """Pictures of each octave in which keypoints are described, one a layer; the unit is 1 / ``FRACTION``
    grey level."""
    difference: Short
    """Differences of subsequent pictures of all octaves, one after the other."""
    begin: Ints
    """(octaves + 1,) first entry of each octave in ``difference``."""

    @staticmethod
    def of(grey: NDArray[np.uint8]) -> ScaleSpace:
        """Return the scale space of a grey picture (h, w), both at least ``SMALLEST_SIDE_PX``."""
        shapes = [(2 * grey.shape[0], 2 * grey.shape[1])]
        while min(half := tuple((side + 1) // 2 for side in shapes[-1])) >= SMALLEST_SIDE_PX:
            shapes.append(half)
        begin = np.cumsum([0] + [(PICTURES - 1) * h * w for h, w in shapes])
        difference = np.empty(begin[-1], np.int16)
        fine = cv2.resize(grey.astype(np.int16) * np.int16(FRACTION), shapes[0][::-1])
        first = _blurred(np.asarray(fine, dtype=np.int16), 2 * CAMERA_SIGMA_PX, SIGMA_PX)
        octaves: list[list[Short]] = []
        for shape, start in zip(shapes, begin, strict=False):
            between = difference[start : start + (PICTURES - 1) * first.size].reshape(-1, *shape)
            layers, last = list[Short](), first
            for k in range(PICTURES - 1):
                following = _blurred(last, _BLUR_PX[k], _BLUR_PX[k + 1])
                cv2.subtract(following, last, dst=between[k])
                layers, last = [*layers, following][:LAYERS], following
            octaves.append(layers)
            first = np.ascontiguousarray(layers[-1][::2, ::2])
        return ScaleSpace(octaves, difference, begin)

    def keypoints(self) -> Keypoints:
        """Return all keypoints, octave by octave."""
        shape = np.array([octave[0].shape for octave in self.blurred])
        coarse = [
            _extrema(self.difference[a:b].reshape(-1, *size), octave)
            for octave, (a, b, size) in enumerate(zip(self.begin, self.begin[1:], shape, strict=False))
        ]
        at, found = np.concatenate(coarse, axis=1), []
        for _ in range(STEPS):
            (height, width), unit = shape[at[0]].T, np.ones_like(at[0])
            stride = np.stack([height * width, width, unit], axis=1)
            index = self.begin[at[0]] + np.einsum("nk,kn->n", stride, at[1:])
            fit = _Fit.of(self.difference[index + _NEIGHBOURS @ stride.T].astype(np.float32))
            kept = fit.is_inside & fit.is_distinct
            found.append(np.vstack([index[kept], at[:, kept], fit.offset[:, kept], fit.contrast[kept]]))
            at = at[:, fit.is_near & ~fit.is_inside]
            at[1:] += np.rint(fit.offset[:, fit.is_near & ~fit.is_inside]).astype(np.int64)
            at = at[:, _within(at[1:], shape[at[0]].T)]
            if at.shape[1] == 0:
                break
        each = np.concatenate(found, axis=1)
        _, once = np.unique(each[0], return_index=True)  # several steps may end at one extremum
        _, octave, layer, row, column, *offset, contrast = each[:, once]
        return Keypoints(
            octave.astype(np.int64), layer.astype(np.int64),
            np.stack([column + offset[2], row + offset[1]], axis=1),
            SIGMA_PX * 2.0 ** ((layer + offset[0]) / LAYERS), contrast / FRACTION,
        )  # fmt: skip


def _blurred(picture: Short, before_px: float, after_px: float) -> Short:
    """Return a picture of blur ``before_px`` with the blur ``after_px``."""
    sigma = float(np.sqrt(after_px**2 - before_px**2))
    side = 2 * int(np.ceil(3.5 * sigma)) + 1  # beyond that it changes most pictures by less than their unit
    return np.asarray(cv2.GaussianBlur(picture, (side, side), sigma), dtype=np.int16)


def _extrema(difference: Short, octave: int) -> Ints:
    """Return octave, layer, row and column (4, n) of pixels that are extreme among 26 neighbours in the
    differences (layers, h, w) of an octave."""
    # Half of the contrast, as in OpenCV: the refined extremum may be higher.
    least, end = max(1, int(0.5 * CONTRAST / LAYERS * WHITE * FRACTION)), difference.shape[1] - BORDER_PX
    found = []
    for first in range(BORDER_PX, end, STRIP_ROWS):
        strip = difference[:, first - 1 : min(first + STRIP_ROWS, end) + 1]
        for k in range(1, LAYERS + 1):
            below, here, above = strip[k - 1 : k + 2]
            highest = cv2.dilate(cv2.max(cv2.max(below, here), above), _SQUARE)
            lowest = cv2.erode(cv2.min(cv2.min(below, here), above), _SQUARE)
            extreme = cv2.bitwise_or(
                cv2.compare(here, cv2.max(highest, least), cv2.CMP_EQ),
                cv2.compare(here, cv2.min(lowest, -least), cv2.CMP_EQ),
            )
            inner = np.ascontiguousarray(extreme[1:-1, BORDER_PX:-BORDER_PX])
            row, column = np.divmod(_nonzero(inner), inner.shape[1])
            octave_and_layer = np.full_like(row, octave), np.full_like(row, k)
            found.append(np.stack([*octave_and_layer, row + first, column + BORDER_PX]))
    return np.concatenate(found, axis=1)


def _nonzero(few: NDArray[np.uint8]) -> Ints:
    """Return the indices of non-zero bytes; six times as fast as numpy's where they are few."""
    byte = few.ravel()
    end = len(byte) // 8 * 8
    eight = np.flatnonzero(byte[:end].view(np.uint64))
    index = (eight[:, None] * 8 + np.arange(8)).ravel()
    return np.concatenate([index[byte[index] != 0], end + np.flatnonzero(byte[end:])])


def _within(at: Ints, shape: Ints) -> NDArray[np.bool_]:
    """Return (n,) whether layers, rows and columns (3, n) are within octaves of a shape (2, n)."""
    inner = (at[1:] >= BORDER_PX) & (at[1:] < shape - BORDER_PX)
    return np.asarray((at[0] >= 1) & (at[0] <= LAYERS) & inner.all(axis=0))


@dataclass(frozen=True)
class _Fit:
    """Quadratic fits to the differences of Gaussians about n pixels. Source: Brown and Lowe 2002."""

    offset: Floats
    """(3, n) of the extremum from the pixel, in layer, row and column."""
    contrast: Floats
    """(n,) absolute value of the extremum."""
    is_near: NDArray[np.bool_]
    """(n,) whether there is an extremum not far from the pixel."""
    is_inside: NDArray[np.bool_]
    """(n,) whether it is within the pixel and the layer."""
    is_distinct: NDArray[np.bool_]
    """(n,) whether it has enough contrast and is not on an edge."""

    @staticmethod
    def of(value: Floats) -> _Fit:
        """Return the fits to values (19, n) of the pixels of ``_NEIGHBOURS``."""
        half, quarter = np.float32(0.5), np.float32(0.25)
        ahead, behind, across = value[1:7:2], value[2:7:2], value[7:]
        slope, (ss, yy, xx) = half * (ahead - behind), ahead + behind - 2 * value[0]
        sy, sx, yx = quarter * (across[::4] - across[1::4] - across[2::4] + across[3::4])
        floor = yy * xx - yx * yx
        adjugate = np.array([
            [floor, sx * yx - sy * xx, sy * yx - sx * yy],
            [sx * yx - sy * xx, ss * xx - sx * sx, sx * sy - ss * yx],
            [sy * yx - sx * yy, sx * sy - ss * yx, ss * yy - sy * sy],
        ])  # fmt: skip
        determinant = ss * adjugate[0, 0] + sy * adjugate[0, 1] + sx * adjugate[0, 2]
        determinant[np.abs(determinant) < 1e-6] = np.nan  # flat: its offset is far too
        offset = -np.einsum("abn,bn->an", adjugate, slope) / determinant
        contrast = np.abs(value[0] + half * np.einsum("an,an->n", slope, offset))
        furthest = np.abs(offset).max(axis=0)
        return _Fit(
            offset,
            contrast,
            furthest < SMALLEST_SIDE_PX,
            furthest < half,
            (contrast >= CONTRAST / LAYERS * WHITE * FRACTION)
            & (floor > 0)
            & ((yy + xx) ** 2 * np.float32(EDGE_RATIO) < np.float32((EDGE_RATIO + 1) ** 2) * floor),
        )
