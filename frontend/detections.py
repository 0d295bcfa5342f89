"""Points that a detector finds in a picture, and the choice of those that are kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from frontend.cells import COUNT, cells, place_in_run

Array = NDArray[np.float64]

CROWDING_SHARE = 0.68
"""Features are crowded if the fullest third of the cells holds more than this share of them. On floors it
holds half to two thirds."""
LIMIT_REACHED_RATIO = 0.9
"""Share of the limit below which features are few, and none stands in the way of another."""


@dataclass(frozen=True)
class Described:
    """Points of a searched picture that are kept, with their descriptors."""

    pixel: Array
    """(n, 2) in that picture."""
    size_px: Array
    """(n,) diameters."""
    response: Array
    """(n,) strengths."""
    descriptor: NDArray[Any]
    """(n, d) as they were found."""


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

    def strongest(self, limit: int) -> NDArray[np.int64]:
        """Return up to ``limit`` points: the strongest, or, where these are crowded, no more of each cell
        than an even share among the cells that have any.

        A textured object, such as a landing gear or a passer-by, could otherwise use up the limit and leave
        no features for the floor.
        """
        chosen = self.by_strength[:limit]
        return self._evenly(limit) if self._are_crowded(chosen, limit) else chosen

    def _are_crowded(self, chosen: NDArray[np.int64], limit: int) -> bool:
        count = np.sort(np.bincount(self.cell[chosen], minlength=COUNT))
        reached = len(chosen) >= LIMIT_REACHED_RATIO * limit
        return bool(reached and count[-COUNT // 3 :].sum() > CROWDING_SHARE * len(chosen))

    def _evenly(self, limit: int) -> NDArray[np.int64]:
        """Return the strongest points of each cell, an even share of the limit, strongest first."""
        cell = self.cell[self.by_strength]
        by_cell = np.argsort(cell, kind="stable")
        share = np.ceil(limit / len(np.unique(cell)))
        kept = np.sort(by_cell[place_in_run(cell[by_cell]) < share])
        evenly: NDArray[np.int64] = self.by_strength[kept][:limit]
        return evenly
