"""A measurement of two keyframes over a floor of lines, among those of `backend.measurements`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AlignedPair:
    """Keyframe ``j``, aligned with keyframe ``k`` by grey levels: a homography over the floor.

    Four points of j and their places in k give it. Lines leave directions open, in which the covariance is
    as large as the picture.
    """

    k: int
    j: int
    pixel: Array
    """(4, 2) undistorted pixel coordinates in j."""
    k_pixel: Array
    """(4, 2) the same points in k."""
    covariance: Array
    """(8, 8) of ``k_pixel``, px²."""

    @property
    def keyframes(self) -> tuple[int, int]:
        """Numbers of both keyframes."""
        return self.k, self.j

    def renumbered(self, number: Mapping[int, int]) -> AlignedPair:
        """Return the pair with other numbers of its keyframes: old -> new."""
        return replace(self, k=number[self.k], j=number[self.j])
