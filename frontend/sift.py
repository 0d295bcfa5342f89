"""SIFT: keypoints of the scale space, described by histograms of gradients.

The keypoints and descriptors are those of OpenCV's SIFT, without the second orientations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from frontend.detections import Described, Detections
from frontend.gradient_histograms import LENGTH, descriptors
from frontend.scale_space import ScaleSpace

Image = NDArray[np.uint8]


class Sift:
    """SIFT of grey pictures."""

    @property
    def no_descriptors(self) -> NDArray[np.float32]:
        """(0, 128) descriptors of no point."""
        return np.empty((0, LENGTH), np.float32)

    def __call__(self, grey: Image, mask: Image | None, limit: int) -> Described | None:
        """Return up to ``limit`` points of a grey picture where ``mask`` is not 0; None without any."""
        space = ScaleSpace.of(grey)
        keypoints = space.keypoints()
        if mask is not None:
            column, row = np.rint(keypoints.pixel).astype(np.int64).T
            keypoints = keypoints[np.flatnonzero(mask[row, column])]
        attributes = np.stack([keypoints.size_px, keypoints.response])
        found = Detections.of(keypoints.pixel, attributes, grey.shape[::-1])
        kept = keypoints[found.strongest(limit)]
        if len(kept) == 0:
            return None
        return Described(kept.pixel, kept.size_px, kept.response, descriptors(space, kept))
