"""Elevation map: height of the ground measured by the sonar, in addition to the visual map.

Source: IMAV 2011 paper, section 3.1.1 (an elevation map grown from the sonar together with the visual map).
A sonar measures one height for the whole footprint of its beam. Each cell takes the median of the nearest
echoes whose beams reach it. The lowest echo would erase an obstacle where the beam is narrower than
specified; the highest would enlarge it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

NEAREST = 5
"""Number of nearest echoes used by a cell."""
CELLS_A_RADIUS = 8
MOST_CELLS = 1_000_000


@dataclass(frozen=True)
class Elevation:
    """Heights over the floor on a lattice; cell (r, c) has its centre at x = west + (c + 1/2) gsd,
    y = north - (r + 1/2) gsd."""

    west_m: float
    north_m: float
    gsd_m: float
    height_m: NDArray[np.float32]
    """(rows, cols); NaN where nothing was measured."""

    def at(self, x_m: Array, y_m: Array) -> NDArray[np.float32]:
        """Return heights at positions of one shape; NaN outside the map and where nothing was measured."""
        with np.errstate(invalid="ignore"):
            r = np.floor((self.north_m - y_m) / self.gsd_m)
            c = np.floor((x_m - self.west_m) / self.gsd_m)
            rows, cols = self.height_m.shape
            inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
        out = np.full(np.shape(x_m), np.nan, np.float32)
        out[inside] = self.height_m[r[inside].astype(int), c[inside].astype(int)]
        return out


def elevation_map(
    w_p_echo_m: Array, height_m: Array, radius_m: Array, cells_a_radius: float = CELLS_A_RADIUS
) -> Elevation | None:
    """Build the map from echoes at (x, y) with beam radius and height above the floor.

    ``w_p_echo_m`` (m, 2), ``height_m`` (m,), ``radius_m`` (m,). ``cells_a_radius``: cells in the median
    radius. None where there is no echo.
    """
    known = np.isfinite(np.column_stack([w_p_echo_m, height_m, radius_m])).all(axis=1)
    place, height, radius = w_p_echo_m[known], height_m[known], radius_m[known]
    if len(place) == 0:
        return None
    low, high = (place - radius[:, None]).min(axis=0), (place + radius[:, None]).max(axis=0)
    fewest = float(np.sqrt((high - low).prod() / MOST_CELLS))
    gsd = max(float(np.median(radius)) / cells_a_radius, fewest)
    cols, rows = np.maximum(np.ceil((high - low) / gsd).astype(int), 1)
    x = low[0] + (np.arange(cols) + 0.5) * gsd
    y = high[1] - (np.arange(rows) + 0.5) * gsd
    cell = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    nearest = min(NEAREST, len(place))
    reach = float(radius.max())
    distance, echo = cKDTree(place).query(cell, range(1, nearest + 1), distance_upper_bound=reach)
    within = np.isfinite(distance) & (distance <= np.append(radius, 0.0)[echo])
    reaching = np.where(within, np.append(height, np.nan)[echo], np.nan)
    heights = np.full(len(cell), np.nan)
    some = within.any(axis=1)
    heights[some] = np.nanmedian(reaching[some], axis=1)
    return Elevation(float(low[0]), float(high[1]), gsd, heights.reshape(rows, cols).astype(np.float32))
