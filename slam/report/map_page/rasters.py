"""Rasters of an output folder as the page needs them: pyramids of image tiles, and grids of values."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]

TILE_PX = 256
MOST_PIXELS = 12_000_000
"""Largest image on the page. A browser opens a page of such an image and its chain (5 to 10 MB) in a second;
mosaic.tif has all pixels."""
MOST_CELLS = 40_000
"""Largest grid of values: finer cells would be smaller than a screen's pixels on the whole map."""
_QUALITY = 70
"""WebP quality at which tiles of a textured floor take about a third of a byte a pixel."""


@dataclass(frozen=True)
class Image:
    """A picture of the ground."""

    rgba: Pixels
    """(rows, cols, 4)."""
    west_m: float
    north_m: float
    gsd_m: float


@dataclass(frozen=True)
class TileSet:
    """Images as tiles over one frame; level z has pixels of ``gsd_m * 2 ** (levels - 1 - z)``."""

    west_m: float
    north_m: float
    gsd_m: float
    levels: int
    tiles: Mapping[str, Mapping[str, str]]
    """Name of an image -> ``z/x/y`` -> WebP in base64; tiles without content are left out."""

    def to_json(self) -> dict[str, Any]:
        """Return the set for the page's script."""
        return {
            "west": self.west_m, "north": self.north_m, "gsd": self.gsd_m,
            "levels": self.levels, "tilePx": TILE_PX, "images": self.tiles,
        }  # fmt: skip


def read_images(paths: Mapping[str, Path], most_pixels: int = MOST_PIXELS) -> dict[str, Image]:
    """Read georeferenced pictures of one resolution, reduced alike until the largest has ``most_pixels``."""
    import rasterio  # GDAL takes a tenth of a second to load, and the map of a graph has no rasters

    sizes = []
    for path in paths.values():
        with rasterio.open(path) as source:
            sizes.append(source.width * source.height)
    shrink = max(1, math.ceil(math.sqrt(max(sizes, default=0) / most_pixels)))
    return {name: _read(path, shrink) for name, path in paths.items()}


def _read(path: Path, shrink: int) -> Image:
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import Window

    with rasterio.open(path) as source:
        cols, rows = max(1, source.width // shrink), max(1, source.height // shrink)
        window = Window(0, 0, min(source.width, cols * shrink), min(source.height, rows * shrink))
        pixels = source.read(window=window, out_shape=(4, rows, cols), resampling=Resampling.average)
        at = source.transform
    return Image(np.ascontiguousarray(np.moveaxis(pixels, 0, 2)), at.c, at.f, at.a * shrink)


def tile_set(images: Mapping[str, Image]) -> TileSet:
    """Cut images of one resolution into tiles over a common frame.

    The first image lies exactly; others are moved by up to half a pixel onto its pixels.
    """
    first = next(iter(images.values()))
    gsd_m = first.gsd_m
    west = max(math.ceil((first.west_m - image.west_m) / gsd_m) for image in images.values())
    north = max(math.ceil((image.north_m - first.north_m) / gsd_m) for image in images.values())
    west_m, north_m = first.west_m - west * gsd_m, first.north_m + north * gsd_m
    corners = {
        name: (round((north_m - image.north_m) / gsd_m), round((image.west_m - west_m) / gsd_m))
        for name, image in images.items()
    }
    longest = max(
        max(row + image.rgba.shape[0], col + image.rgba.shape[1])
        for image, (row, col) in zip(images.values(), corners.values(), strict=True)
    )
    levels = 1 + max(0, math.ceil(math.log2(longest / TILE_PX)))
    tiles = {name: dict(_tiles(image.rgba, *corners[name], levels)) for name, image in images.items()}
    return TileSet(west_m, north_m, gsd_m, levels, tiles)


def _tiles(rgba: Pixels, row: int, col: int, levels: int) -> Iterator[tuple[str, str]]:
    """Yield name and content of the tiles of an image whose first pixel lies at (row, col) of its frame."""
    for z in reversed(range(levels)):
        # With its empty margin the image begins at the corner of a tile.
        rgba = _with_margin(rgba, row % TILE_PX, col % TILE_PX, TILE_PX)
        row, col = row - row % TILE_PX, col - col % TILE_PX
        for top in range(0, rgba.shape[0], TILE_PX):
            for left in range(0, rgba.shape[1], TILE_PX):
                tile = rgba[top : top + TILE_PX, left : left + TILE_PX]
                if tile[..., 3].any():
                    name = f"{z}/{(col + left) // TILE_PX}/{(row + top) // TILE_PX}"
                    yield name, webp(cv2.cvtColor(tile, cv2.COLOR_RGBA2BGRA), _QUALITY)
        rgba, row, col = _halved(rgba), row // 2, col // 2


def _with_margin(rgba: Pixels, top: int, left: int, multiple: int) -> Pixels:
    """Add ``top`` rows and ``left`` columns before an image, and as many behind as make it a multiple."""
    rows, cols = rgba.shape[0] + top, rgba.shape[1] + left
    shape = -(-rows // multiple) * multiple, -(-cols // multiple) * multiple, 4
    wider = np.zeros(shape, np.uint8)
    wider[top:rows, left:cols] = rgba
    return wider


def _halved(rgba: Pixels) -> Pixels:
    """Halve an image; a transparent pixel has no part in the colour of the mean."""
    seen = np.where(rgba[..., 3:] > 0, rgba, np.uint8(0))
    small = cv2.resize(seen, (rgba.shape[1] // 2, rgba.shape[0] // 2), interpolation=cv2.INTER_AREA)
    share = np.maximum(small[..., 3:].astype(np.float32), 1.0) / 255
    colour = np.minimum(small[..., :3] / share, 255).astype(np.uint8)
    return np.concatenate([colour, small[..., 3:]], axis=2)


def webp(pixels: Pixels, quality: int) -> str:
    """Encode pixels (rows, cols, 3 or 4), blue first, as WebP in base64."""
    code = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])[1]
    return base64.b64encode(code.tobytes()).decode("ascii")


def value_grid(path: Path, band: int) -> dict[str, Any] | None:
    """Read a band of a raster of values as float32 in base64, row by row from the north-west corner.

    Cells are averaged until there are at most ``MOST_CELLS``. Return None where no cell has a value.
    """
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.windows import Window

    with rasterio.open(path) as source:
        shrink = max(1, math.ceil(math.sqrt(source.width * source.height / MOST_CELLS)))
        cols, rows = max(1, source.width // shrink), max(1, source.height // shrink)
        window = Window(0, 0, min(source.width, cols * shrink), min(source.height, rows * shrink))
        values = source.read(band, window=window, out_shape=(rows, cols), resampling=Resampling.average)
        at = source.transform
    if not np.isfinite(values).any():
        return None
    low, high = np.nanpercentile(values, [0.5, 99.5]).tolist()
    data = base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")
    return {
        "west": at.c, "north": at.f, "cell": at.a * shrink, "cols": cols, "rows": rows,
        "low": low, "high": high, "data": data,
    }  # fmt: skip
