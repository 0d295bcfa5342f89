"""Which keyframes can have seen the same ground, as the poses known so far and their uncertainty have it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reach:
    """Around each keyframe the circle that holds all that it may have seen."""

    w_p_b: Array
    """(n, 3) positions, in the units of the pose graph."""
    radius: Array
    """(n,) half the view's diagonal and some standard deviations of the position; NaN where not known."""
    component: NDArray[np.int64]
    """(n,) parts that nothing joins yet have no place relative to each other."""

    def holds(self, j: int, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(m,) which keyframes may have seen what ``j`` has; all of which nothing is known."""
        apart, most = self._apart(j, rows)
        return np.asarray(~((apart > most) & (self.component[rows] == self.component[j])))

    def reason(self, i: int, j: int) -> str:
        """Why a pair beyond reach is not compared."""
        apart, most = self._apart(j, np.array([i]))
        return f"out of reach: {apart[0]:.2f} apart where the poses have it, with {most[0]:.2f} allowed"

    def _apart(self, j: int, rows: NDArray[np.int64]) -> tuple[Array, Array]:
        apart = np.linalg.norm(self.w_p_b[rows] - self.w_p_b[j], axis=1)
        return apart, self.radius[rows] + self.radius[j]
