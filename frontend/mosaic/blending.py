"""Multi-band blending. Each frequency band is blended over a width that matches its scale.

Each band is divided by the sum of its masks, so that the border of a hole does not become dark.
Source: Burt and Adelson 1983, A multiresolution spline with application to image mosaics, section 3.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

BANDS = 5
REACH_PX = 64
"""Largest distance over which a pixel has influence: 2 (2^4 - 1) px down the pyramid and the same up, rounded
up to whole cells."""


class MultiBand:
    """Accumulator of a rectangle, into which pictures are blended one after the other."""

    def __init__(self, rows: int, cols: int) -> None:
        """Make it empty. ``rows`` and ``cols`` are multiples of 2^(BANDS - 1)."""
        shapes = [(rows >> band, cols >> band) for band in range(BANDS)]
        self._sum = [np.zeros((*shape, 3), np.float32) for shape in shapes]
        self._weight = [np.zeros(shape, np.float32) for shape in shapes]

    def add(self, picture: Float32, mask: Float32, row: int, col: int) -> None:
        """Add a picture (h, w, 3) where its mask (h, w) is 1, with its first pixel at (row, col).

        h, w, ``row`` and ``col`` are multiples of 2^(BANDS - 1). The picture must have content up to
        ``REACH_PX`` around its mask, mirrored if necessary.
        """
        for band in range(BANDS):
            if band + 1 < BANDS:
                below = cv2.pyrDown(picture)
                detail = picture - cv2.pyrUp(below, dstsize=(picture.shape[1], picture.shape[0]))
                mask_below = cv2.pyrDown(mask)
            else:
                below, detail, mask_below = picture, picture, mask
            r, c = row >> band, col >> band
            area = (slice(r, r + mask.shape[0]), slice(c, c + mask.shape[1]))
            self._sum[band][area] += detail * mask[..., None]
            self._weight[band][area] += mask
            picture, mask = below, mask_below

    def blend(self) -> Float32:
        """Return the blended picture (rows, cols, 3), undefined where no mask was set."""
        out: Float32 | None = None
        for total, weight in zip(reversed(self._sum), reversed(self._weight), strict=True):
            detail = np.divide(total, np.maximum(weight, 1e-20)[..., None], dtype=np.float32)
            out = (
                detail if out is None else cv2.pyrUp(out, dstsize=(detail.shape[1], detail.shape[0])) + detail
            )
        assert out is not None
        return out
