"""Feature positions of one picture and their relative uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Points:
    """Points of one picture."""

    pixel: Array
    """(n, 2) undistorted pixel positions at full size."""
    spread: Array
    """(n,) standard deviation of a position relative to that of a typical feature of the picture."""

    @staticmethod
    def alike(pixel: Array) -> Points:
        """Return points of equal uncertainty."""
        return Points(pixel, np.ones(len(pixel)))

    def __len__(self) -> int:
        return len(self.pixel)

    def __getitem__(self, which: NDArray[Any]) -> Points:
        return Points(self.pixel[which], self.spread[which])

    @cached_property
    def spot(self) -> NDArray[np.int64]:
        """Return (n,) the first point at the same place: some detectors have one for each orientation."""
        _, first, of = np.unique(self.pixel @ [1.0, 1.0j], return_index=True, return_inverse=True)
        return first[of]
