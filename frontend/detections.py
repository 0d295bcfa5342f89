"""Choice of the features that are kept of all that a detector finds in a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.cells import COUNT, cells, place_in_run

Array = NDArray[np.float64]

CROWDING_SHARE = 0.68
"""Features are crowded if the fullest third of the cells holds more than this share of them. On floors it
holds half to two thirds. In crowded pictures, cells with less than half of an even share keep all their
points, and fuller cells keep only an even share."""
SPARSE_CELL_RATIO, LIMIT_REACHED_RATIO = 0.5, 0.9


@dataclass(frozen=True)
class Detections:
    """Distribution and strength of all points that a detector finds in a picture."""

    cell: NDArray[np.int64]
    """(n,) cell of each."""
    by_strength: NDArray[np.int64]
    """(n,) their order, strongest first."""

    @staticmethod
    def of(pixel: Array, attributes: Array, size_px: tuple[int, int]) -> Detections:
        """Return those at (n, 2) pixels of a picture (width, height).

        ``attributes`` (k, n): the last row is the strength, the others decide between equal strengths. The
        order does not depend on how the points were found.
        """
        order = np.lexsort((*attributes[-2::-1], *pixel.T, -attributes[-1]))
        return Detections(cells(pixel, size_px), order)

    def are_crowded(self, limit: int) -> bool:
        """Return whether the ``limit`` strongest points are crowded."""
        count = np.bincount(self.cell[self.by_strength[:limit]], minlength=COUNT)
        full = count.sum() >= LIMIT_REACHED_RATIO * limit
        return bool(full and np.sort(count)[-COUNT // 3 :].sum() > CROWDING_SHARE * count.sum())

    def strongest(self, limit: int) -> NDArray[np.int64]:
        """Return up to ``limit`` points: the strongest, or, where these are crowded, fewer of the full cells.

        A textured object, such as a landing gear or a passer-by, could otherwise use up the limit and leave
        no features for the floor.
        """
        chosen = self.by_strength[:limit]
        if self.are_crowded(limit):
            sparse = np.bincount(self.cell[chosen], minlength=COUNT) < SPARSE_CELL_RATIO * limit / COUNT
            within = self._limited_per_cell(chosen[~sparse[self.cell[chosen]]], round(limit / COUNT))
            others = self.by_strength[sparse[self.cell[self.by_strength]]]
            chosen = np.concatenate([within, others[: limit - len(within)]])
        return chosen

    def _limited_per_cell(self, chosen: NDArray[np.int64], quota: int) -> NDArray[np.int64]:
        """Return the first ``quota`` of the ``chosen`` points (k,) in each cell, in their order."""
        cell = self.cell[chosen]
        by_cell = np.argsort(cell, kind="stable")
        first = np.zeros(len(chosen), dtype=bool)
        first[by_cell[place_in_run(cell[by_cell]) < quota]] = True
        return chosen[first]
