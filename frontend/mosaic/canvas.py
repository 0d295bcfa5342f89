"""Position of a mosaic on the floor, in whole pixels of a grid over the plane.

Column 0 of the grid begins at x = 0 and row 0 at y = 0. Columns count to the east and rows to the south.
Cells, tiles and sampling points are aligned to the same grid, so they stay the same if a mosaic grows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.mosaic.extent import native_gsd_m, offered_extents
from frontend.mosaic.view import Lattice, MosaicView

Array = NDArray[np.float64]

CELL_PX = 16
"""Side of the cells to which owners are assigned. The blending pyramid requires a power of two."""
SOFT_CELLS = 2
"""Smoothing radius of the owners, in cells. A picture can take over from another one within this distance."""
TILE_PX = 1024
"""Side of a tile, a multiple of the cell's side."""
MAX_PIXELS = 4e9
MIN_BUDGET_PX = 4 * CELL_PX**2
"""Smallest pixel budget, since rounding to whole cells on two sides may need as many pixels."""


class MosaicError(ValueError):
    """No mosaic can be made. The message gives the reason in one line."""


@dataclass(frozen=True)
class Tile:
    """Rectangle of mosaic pixels."""

    row: int
    col: int
    """First pixel."""
    rows: int
    cols: int


@dataclass(frozen=True)
class SquareGrid:
    """Grid of equal squares of mosaic pixels."""

    pitch_px: int
    row: int
    col: int
    """First pixel of the first square. It may lie outside the mosaic."""
    rows: int
    cols: int
    """Number of columns, in squares."""


@dataclass(frozen=True)
class MosaicGrid:
    """Rectangle of the grid that the mosaic fills.

    Pixel (r, c) has its centre at x = (first_col + c + 1/2) gsd_m, y = -(first_row + r + 1/2) gsd_m.
    """

    gsd_m: float
    first_row: int
    first_col: int
    """Position in the grid, in pixels; multiples of ``CELL_PX``."""
    width: int
    height: int
    """Size in pixels."""
    tile_px: int = TILE_PX

    @property
    def west_m(self) -> float:
        """Western edge of the first pixel, in metres."""
        return self.first_col * self.gsd_m

    @property
    def north_m(self) -> float:
        """Northern edge of the first pixel, in metres."""
        return -self.first_row * self.gsd_m

    @property
    def tiles(self) -> Iterator[Tile]:
        """All tiles, row by row. Tiles at the border of the mosaic may be smaller."""
        for row, rows in _pieces(self.first_row, self.height, self.tile_px):
            for col, cols in _pieces(self.first_col, self.width, self.tile_px):
                yield Tile(row, col, rows, cols)

    @property
    def cell_shape(self) -> tuple[int, int]:
        """Numbers of rows and columns of cells. The last ones may extend beyond the mosaic."""
        return -(-self.height // CELL_PX), -(-self.width // CELL_PX)

    def lattice(self, row: int, col: int, rows: int, cols: int, pitch_px: int = 1) -> Lattice:
        """Return the centres of squares of ``pitch_px``, from a pixel on, also outside the mosaic."""
        # Computed from integers, so that the result is bitwise equal for every mosaic with this pixel.
        x = (self.first_col + col + pitch_px / 2) * self.gsd_m
        y = -(self.first_row + row + pitch_px / 2) * self.gsd_m
        return Lattice(x, y, self.gsd_m * pitch_px, rows, cols)

    def cells_under(self, view: MosaicView) -> tuple[tuple[slice, slice], Lattice]:
        """Return the rows and columns of the cells under a picture, and their centres."""
        return self.squares_under(view, SquareGrid(CELL_PX, 0, 0, *self.cell_shape))

    def squares_under(self, view: MosaicView, squares: SquareGrid) -> tuple[tuple[slice, slice], Lattice]:
        """Return the rows and columns of the squares under a picture, and their centres."""
        pitch = squares.pitch_px
        west, south, east, north = view.bounds_m / (pitch * self.gsd_m)
        left = (self.first_col + squares.col) / pitch
        top = (self.first_row + squares.row) / pitch
        r0, r1 = max(int(-north - top), 0), min(int(-south - top) + 1, squares.rows)
        c0, c1 = max(int(west - left), 0), min(int(east - left) + 1, squares.cols)
        lattice = self.lattice(squares.row + r0 * pitch, squares.col + c0 * pitch, r1 - r0, c1 - c0, pitch)
        return (slice(r0, r1), slice(c0, c1)), lattice


def grid_over(
    views: Sequence[MosaicView], gsd_m: float | None, max_pixels: int, unit: str = "m"
) -> tuple[MosaicGrid, Array, str]:
    """Return the grid that contains all views, its extent (4,) in metres, and a note about its resolution.

    If ``gsd_m`` is None, the resolution is that of the pictures, coarser if the mosaic would exceed
    ``max_pixels``. It is rounded to two digits, so that one more picture rarely changes it. ``unit`` is the
    name of the unit of length in the texts. A grid that would exceed ``max_pixels``, or ``MAX_PIXELS`` with a
    given ``gsd_m``, goes first without ground that pictures show coarsely: `frontend.mosaic.extent`.

    Raises ``MosaicError`` if the given ``gsd_m`` needs more than ``MAX_PIXELS``.
    """
    if gsd_m is not None:
        canvas, extent = _largest(offered_extents(views, gsd_m), gsd_m, MAX_PIXELS)
        size_m = extent[2:] - extent[:2]
        if (pixels := float(np.prod(size_m)) / gsd_m**2) > MAX_PIXELS:
            raise MosaicError(
                f"{gsd_m:g} {unit}/pixel would give {pixels:.2g} pixels over {size_m[0]:.3g} x "
                f"{size_m[1]:.3g} {unit}; choose {gsd_m * np.sqrt(pixels / MAX_PIXELS):.2g} {unit}/pixel or "
                "coarser"
            )
        return canvas, extent, ""
    native = _two_digits(native_gsd_m(views))
    budget = max(max_pixels, MIN_BUDGET_PX)
    extents = offered_extents(views, native)
    canvas, extent = _largest(extents, native, budget)
    while (excess := canvas.width * canvas.height / budget) > 1:
        coarser = _two_digits(canvas.gsd_m * float(np.sqrt(excess)))
        if coarser <= canvas.gsd_m:
            coarser = _two_digits(1.1 * canvas.gsd_m)
        canvas, extent = _largest(extents, coarser, budget)
    note = ""
    if canvas.gsd_m != native:
        note = (
            f"the pictures have {native:.3g} {unit}/pixel; the mosaic has {canvas.gsd_m:.3g} {unit}/pixel to "
            f"stay below {max_pixels / 1e6:.0f} megapixels"
        )
    return canvas, extent, note


def _largest(extents: Sequence[Array], gsd_m: float, max_pixels: float) -> tuple[MosaicGrid, Array]:
    """Return the grid and the bounds (4,) of the first extent within a number of pixels, or of the last."""
    for extent in extents:
        canvas = _canvas(extent, gsd_m)
        if canvas.width * canvas.height <= max_pixels:
            break
    return canvas, extent


def _canvas(extent_m: Array, gsd_m: float) -> MosaicGrid:
    """Return the grid over an extent, rounded out to whole cells (west, north) or pixels."""
    west, south, east, north = extent_m / gsd_m
    col, row = (int(np.floor(at / CELL_PX)) * CELL_PX for at in (west, -north))
    width, height = max(int(np.ceil(east)) - col, 1), max(int(np.ceil(-south)) - row, 1)
    return MosaicGrid(gsd_m, row, col, width, height)


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


def _pieces(first: int, size: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield start and length of the pieces of ``size`` pixels, divided at multiples of ``step``."""
    begin = 0
    while begin < size:
        end = min((first + begin) // step * step + step - first, size)
        yield begin, end - begin
        begin = end
