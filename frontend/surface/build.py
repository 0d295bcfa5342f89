"""Surface of a map: dense heights where the ground is not flat, tile by tile; holes are filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from frontend.elevation import Elevation
from frontend.mosaic.canvas import Tile
from frontend.mosaic.checkpoints import with_checkpoints
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import MosaicPlan
from frontend.mosaic.surface import HeightSource, Surface
from frontend.mosaic.view import Lattice, MosaicView
from frontend.surface.dense import COARSEST, DenseHeights, dense_heights
from frontend.surface.holes import filled, without_specks
from frontend.surface.misregistration import SQUARE_PX
from frontend.surface.stereo import Placed

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Report = Callable[[str, int, int], None]

LEAST_CELL_PX = 2
"""Side of a cell in pixels of the mosaic: matched edges are no sharper."""
MOST_CELLS = 16_000_000
"""Largest number of cells, 9 bytes each. Larger maps have larger cells, so that memory stays bounded."""
REDUCTION = np.sqrt(2.0)
"""Side of a cell in pixels of the matched pictures: two pixels a cell, half as many as the pictures have. A
tile takes a third of the time, as there are fewer disparities too."""
MARGIN_CELLS = 16
"""Cells matched around a tile, so that its border is as good as its middle."""


@dataclass(frozen=True)
class _Ground:
    """Pictures of the ground, and the side of a cell in pixels of the mosaic: what all tiles share."""

    plan: MosaicPlan
    pictures: Pictures
    cell_px: int


def build_surface(
    plan: MosaicPlan,
    pictures: Pictures,
    relief: Mask,
    elevation: Elevation | None,
    report: Report | None = None,
    compared: Mask | None = None,
) -> Surface:
    """Measure the ground in the squares with relief (rows, cols); everywhere else it is the floor.

    In squares that are not ``compared`` (rows, cols), nothing shows whether it is. None: all are.

    ``plan`` has all pictures that may be matched. Tiles are shared among the workers; each holds the pairs of
    one tile at a time.
    """
    cell_px = LEAST_CELL_PX
    while plan.width * plan.height > MOST_CELLS * cell_px**2:
        cell_px *= 2
    rows, cols = -(-plan.height // cell_px), -(-plan.width // cell_px)
    height, std = np.zeros((rows, cols), np.float32), np.full((rows, cols), np.nan, np.float32)
    used = _on_cells(_closed(relief), cell_px, (rows, cols))
    tiles = [part for tile in plan.tiles if (part := _part_in_use(tile, used, cell_px)) is not None]
    checkpoints = pictures.checkpoints.stage("surface", plan, cell_px)
    found = with_checkpoints(checkpoints, _tile_heights, _Ground(plan, pictures, cell_px), tiles)
    for done, (tile, dense) in enumerate(zip(tiles, found, strict=True)):
        if report:
            report("surface", done + 1, len(tiles))
        where = _cells(tile, cell_px)
        height[where], std[where] = dense.height_m, dense.std_m
    height = without_specks(height, COARSEST / REDUCTION * cell_px * plan.gsd_m)
    # Beyond the squares, ground that is higher or lower and connected with them is theirs.
    used = _connected(used, np.abs(height) > plan.gsd_m)
    height[~used] = 0.0
    std[~used] = np.nan
    measured = np.where(np.isfinite(height), HeightSource.PICTURES, HeightSource.FILLED)
    known = np.ones_like(used) if compared is None else _on_cells(compared, cell_px, (rows, cols))
    source = np.where(used, measured, np.where(known, HeightSource.FLOOR, HeightSource.LEVEL))
    surface = Surface(plan.west_m, plan.north_m, cell_px * plan.gsd_m, height, std, source.astype(np.uint8))
    return filled(surface if elevation is None else _with_sonar(surface, elevation))


def _with_sonar(surface: Surface, elevation: Elevation) -> Surface:
    """Return the surface with the sonar's heights where pictures did not measure."""
    r, c = np.nonzero(surface.source == HeightSource.FILLED)
    x, y = surface.west_m + (c + 0.5) * surface.cell_m, surface.north_m - (r + 0.5) * surface.cell_m
    measured = elevation.at(np.asarray(x, float), np.asarray(y, float))
    some = np.isfinite(measured)
    height, source = surface.height_m.copy(), surface.source.copy()
    height[r[some], c[some]], source[r[some], c[some]] = measured[some], HeightSource.SONAR
    return replace(surface, height_m=height, source=source)


def _tile_heights(ground: _Ground, tile: Tile) -> DenseHeights:
    """Match the pictures of a tile, with a margin that is removed again."""
    plan, pictures, cell_px = ground.plan, ground.pictures, ground.cell_px
    rows, cols = -(-tile.rows // cell_px), -(-tile.cols // cell_px)
    margin = MARGIN_CELLS * cell_px
    lattice = plan.lattice(
        tile.row - margin, tile.col - margin, rows + 2 * MARGIN_CELLS, cols + 2 * MARGIN_CELLS, cell_px
    )
    index = {view.k: i for i, view in enumerate(plan.views)}

    def sees(view: MosaicView, nodes: Lattice) -> Mask:
        return plan.pixels(view, nodes)[2]

    def look(view: MosaicView) -> Placed | None:
        picture = pictures[index[view.k]]
        if picture is None:
            return None
        return Placed(plan.camera, view, np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)))

    dense = dense_heights(plan.views, sees, look, lattice, cell_px * plan.gsd_m / REDUCTION)
    inner = slice(MARGIN_CELLS, MARGIN_CELLS + rows), slice(MARGIN_CELLS, MARGIN_CELLS + cols)
    return DenseHeights(dense.height_m[inner], dense.std_m[inner])


def _part_in_use(tile: Tile, used: Mask, cell_px: int) -> Tile | None:
    """Return the part of a tile around the cells in use, with a square on each side of them."""
    rows, cols = _cells(tile, cell_px)
    r, c = np.nonzero(used[rows, cols])
    if len(r) == 0:
        return None
    first = [max(0, (int(k.min()) * cell_px) // SQUARE_PX - 1) * SQUARE_PX for k in (r, c)]
    ends = [((int(k.max()) * cell_px) // SQUARE_PX + 2) * SQUARE_PX for k in (r, c)]
    size = [min(ends[i], whole) - first[i] for i, whole in enumerate((tile.rows, tile.cols))]
    return Tile(tile.row + first[0], tile.col + first[1], *size)


def _cells(tile: Tile, cell_px: int) -> tuple[slice, slice]:
    """Return the cells of a tile."""
    row, col = tile.row // cell_px, tile.col // cell_px
    return slice(row, row + -(-tile.rows // cell_px)), slice(col, col + -(-tile.cols // cell_px))


def _closed(squares: Mask) -> Mask:
    """Return the squares with relief and those between them: a crown of a tree may seem flat by chance."""
    around = np.pad(squares.astype(np.uint8), 1)
    return np.asarray(cv2.morphologyEx(around, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0)


def _connected(used: Mask, raised: Mask) -> Mask:
    """Return the cells in use and the raised cells that are connected with them."""
    label = cv2.connectedComponents((used | raised).astype(np.uint8), connectivity=4)[1]
    kept = np.zeros(int(label.max()) + 1, bool)
    kept[label[used]] = True
    kept[0] = False
    return np.asarray(kept[label])


def _on_cells(squares: Mask, cell_px: int, shape: tuple[int, int]) -> Mask:
    """Return which cells lie in the squares; those beyond the last square count to it."""
    if squares.size == 0:
        return np.zeros(shape, bool)
    r, c = (
        np.minimum(np.arange(n) * cell_px // SQUARE_PX, squares.shape[axis] - 1)
        for axis, n in enumerate(shape)
    )
    return np.asarray(squares[np.ix_(r, c)])
