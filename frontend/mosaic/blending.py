"""Multi-band blending: each band of detail crosses a seam over its own width.

Source: Burt and Adelson 1983, A multiresolution spline with application to image mosaics, section 3. Sums are
divided by the sum of the masks in every band, so that the rim of a hole does not turn dark.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

BANDS = 5
REACH_PX = 64
"""A pixel depends on nothing farther away: 2 (2^4 - 1) px down the pyramid and as much up, in whole cells."""


class MultiBand:
    """A rectangle that pictures are blended into, one after the other."""

    def __init__(self, rows: int, cols: int) -> None:
        """``rows`` and ``cols`` are multiples of 2^(BANDS - 1)."""
        shapes = [(rows >> band, cols >> band) for band in range(BANDS)]
        self._sum = [np.zeros((*shape, 3), np.float32) for shape in shapes]
        self._weight = [np.zeros(shape, np.float32) for shape in shapes]

    def add(self, picture: Float32, mask: Float32, row: int, col: int) -> None:
        """Blend (h, w, 3) in where the mask (h, w) is 1; all four numbers are multiples of 2^(BANDS - 1).

        The picture has content (mirrored, if need be) up to ``REACH_PX`` around its mask.
        """
        for band in range(BANDS):
            if band + 1 < BANDS:
                below = cv2.pyrDown(picture)
                detail = picture - cv2.pyrUp(below, dstsize=(picture.shape[1], picture.shape[0]))
                mask_below = cv2.pyrDown(mask)
            else:
                below, detail, mask_below = picture, picture, mask
            r, c = row >> band, col >> band
            where = (slice(r, r + mask.shape[0]), slice(c, c + mask.shape[1]))
            self._sum[band][where] += detail * mask[..., None]
            self._weight[band][where] += mask
            picture, mask = below, mask_below

    def blend(self) -> Float32:
        """(rows, cols, 3); without meaning where no mask was set."""
        out: Float32 | None = None
        for total, weight in zip(reversed(self._sum), reversed(self._weight), strict=True):
            detail = np.divide(total, np.maximum(weight, 1e-20)[..., None], dtype=np.float32)
            out = (
                detail if out is None else cv2.pyrUp(out, dstsize=(detail.shape[1], detail.shape[0])) + detail
            )
        assert out is not None
        return out
