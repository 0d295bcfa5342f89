"""A mosaic on disk: a Cloud-Optimised GeoTIFF with overviews, and a PNG with a world file.

Both are written from tiles, with memory bounded by GDAL's block cache. The affine of a GeoTIFF refers to the
outer corner of the first pixel, a world file to its centre (ESRI, World files for raster datasets).

The GeoTIFF holds what each block was made of, and a digest of its pixels: a later mosaic takes from it what
it would make again, and nothing that was edited since.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
import rasterio
import rasterio.shutil
from affine import Affine
from numpy.typing import NDArray
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from slam.core.errors import InputError
from slam.core.flight import GeoOrigin
from slam.io.atomic import atomic_file

BLOCK_PX = 512
CACHE_MB = 64
LOCAL_METRES = 'LOCAL_CS["local metres",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
"""A plane in metres that is nowhere on Earth in particular."""
MARKS = "LEMNISCATE_BLOCKS"
"""Metadata item of the GeoTIFF: JSON, mark -> row, column, digest of the pixels."""

_RGBA = {
    "count": 4, "dtype": "uint8", "photometric": "RGB", "alpha": "non-premultiplied", "BIGTIFF": "IF_SAFER",
}  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """Position of the pixels of a north-up raster in the world."""

    west_m: float
    north_m: float
    """Outer corner of the first pixel."""
    gsd_m: float
    width: int
    height: int
    origin: GeoOrigin | None = None
    """Position of x = y = 0 on Earth, x to the east and y to the north; None for a local plane."""
    metric: bool = True
    """Whether lengths are metres; else they are of a unit of the map's own."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """West, east, south and north end."""
        east_m = self.west_m + self.width * self.gsd_m
        return self.west_m, east_m, self.north_m - self.height * self.gsd_m, self.north_m

    @property
    def affine(self) -> Affine:
        """(column, row) of a pixel corner to (x, y)."""
        return Affine(self.gsd_m, 0.0, self.west_m, 0.0, -self.gsd_m, self.north_m)

    @property
    def crs(self) -> CRS | None:
        """Azimuthal equidistant about the origin, so that distances from it are true; or the local plane.

        None where lengths are no metres: a GeoTIFF knows no plane of another unit.

        A map lies on the ellipsoid: ground at altitude h is drawn larger by h / 6371 km (5e-5 at 300 m).
        """
        if self.origin is None:
            return CRS.from_wkt(LOCAL_METRES) if self.metric else None
        return CRS.from_proj4(
            f"+proj=aeqd +lat_0={self.origin.latitude_deg!r} +lon_0={self.origin.longitude_deg!r} "
            "+datum=WGS84 +units=m +no_defs"
        )


@dataclass(frozen=True)
class Block:
    """A rectangle of finished pixels."""

    row: int
    col: int
    rgba: NDArray[np.uint8]
    """(rows, cols, 4); alpha 0 where nothing was seen."""
    mark: str = ""
    """Names what it was made of, for `earlier_blocks`; empty where it shall not be found again."""


EarlierBlock = Callable[[str, tuple[int, int]], "NDArray[np.uint8] | None"]
"""Mark, rows and columns -> the pixels (rows, cols, 4) that a file has under it; None where it has none."""


def write_geotiff(path: Path, grid: Grid, blocks: Iterator[Block]) -> None:
    """Cloud-Optimised GeoTIFF at ``path``, whole or not at all.

    Blocks first go into a plain tiled file beside it, since overviews need all of them.

    Raises ``InputError`` where the disk refuses.
    """
    profile = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "crs": grid.crs,
        "transform": grid.affine, "tiled": True, "blockxsize": BLOCK_PX, "blockysize": BLOCK_PX,
        "compress": "deflate", "zlevel": 1,
        "SPARSE_OK": True, **_RGBA,
    }  # fmt: skip
    with _gdal(path), atomic_file(path) as partial, _scratch(path) as plain:
        total, marks = np.zeros(4, np.uint64), {}
        with rasterio.open(plain, "w", **profile) as raster:
            for block in blocks:
                rows, cols = block.rgba.shape[:2]
                if block.mark:
                    marks[block.mark] = (block.row, block.col, _digest(block.rgba))
                if block.rgba[..., 3].any():
                    window = Window(block.col, block.row, cols, rows)
                    raster.write(np.moveaxis(block.rgba, 2, 0), window=window)
                    total += block.rgba.sum(axis=(0, 1), dtype=np.uint64)
            raster.update_tags(**{MARKS: json.dumps(marks)})
        rasterio.shutil.copy(
            plain, partial, driver="COG", compress="DEFLATE", predictor="YES", blocksize=BLOCK_PX,
            overview_resampling="AVERAGE", bigtiff="IF_SAFER",
        )  # fmt: skip
        _verify(partial, total)


@contextmanager
def earlier_blocks(path: Path) -> Iterator[EarlierBlock]:
    """The marked blocks of a GeoTIFF of ours; none where the file is missing or is not as we wrote it."""
    with ExitStack() as stack:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                raster = stack.enter_context(rasterio.open(path))
            marks = json.loads(raster.tags()[MARKS])
        except (RasterioError, CPLE_BaseError, OSError, ValueError, KeyError):
            yield lambda mark, shape: None
            return

        def earlier(mark: str, shape: tuple[int, int]) -> NDArray[np.uint8] | None:
            try:
                row, col, digest = marks[mark]
                pixels = raster.read(window=Window(col, row, shape[1], shape[0]))
            except (RasterioError, CPLE_BaseError, ValueError, KeyError, TypeError):
                return None
            rgba = np.moveaxis(pixels, 0, 2)
            # What was cut off by the raster's end, edited or damaged has another one.
            return rgba if _digest(rgba) == digest else None

        yield earlier


def _digest(rgba: NDArray[np.uint8]) -> str:
    made = blake2b(repr((rgba.shape, rgba.dtype.str)).encode(), digest_size=16)
    made.update(rgba.tobytes())
    return made.hexdigest()


def write_bands(path: Path, grid: Grid, bands: Mapping[str, NDArray[np.float32]]) -> None:
    """Cloud-Optimised GeoTIFF of measured figures, a band each with its description; NaN where unknown.

    Whole or not at all. Raises ``InputError`` where the disk refuses.
    """
    profile = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "crs": grid.crs,
        "transform": grid.affine, "count": len(bands), "dtype": "float32", "nodata": float("nan"),
    }  # fmt: skip
    with _gdal(path), atomic_file(path) as partial, _scratch(path) as plain:
        with rasterio.open(plain, "w", **profile) as raster:
            for number, (description, values) in enumerate(bands.items(), start=1):
                raster.write(values, number)
                raster.set_band_description(number, description)
        rasterio.shutil.copy(
            plain, partial, driver="COG", compress="DEFLATE", predictor="YES", blocksize=BLOCK_PX,
            overview_resampling="AVERAGE",
        )  # fmt: skip
        with rasterio.open(partial) as raster:
            if not np.array_equal(raster.read(), np.stack(list(bands.values())), equal_nan=True):
                raise RasterioError("pixels are missing from what was written")


def write_png(geotiff: Path, path: Path, max_pixels: int, world_file: bool = True) -> float:
    """PNG of a GeoTIFF of ours, from the first overview with at most ``max_pixels``; gives back its m/pixel.

    The world file beside it (``.pgw``) says where the centre of the first pixel lies.

    Raises ``InputError`` where the disk refuses.
    """
    with _gdal(path), atomic_file(path) as partial, _scratch(path) as plain:
        with _reduced(geotiff, max_pixels) as raster:
            affine, total = raster.transform, np.zeros(4, np.uint64)
            profile = {"driver": "GTiff", "width": raster.width, "height": raster.height, "transform": affine}
            # PNG is made line by line: from tiles that takes twenty times as long as from strips.
            with rasterio.open(plain, "w", blockysize=16, **profile, **_RGBA) as strips:
                for window, pixels in _strips(raster):
                    strips.write(pixels, window=window)
                    total += pixels.sum(axis=(1, 2), dtype=np.uint64)
        _verify(plain, total)
        # Level 6 takes three times as long and saves a twentieth.
        rasterio.shutil.copy(plain, partial, driver="PNG", zlevel=4)
    if world_file:
        lines = (affine.a, 0.0, 0.0, affine.e, affine.c + affine.a / 2, affine.f + affine.e / 2)
        with atomic_file(path.with_suffix(".pgw")) as partial:
            partial.write_text("".join(f"{value:.12g}\n" for value in lines))
    return float(affine.a)


def _reduced(geotiff: Path, max_pixels: int) -> rasterio.DatasetReader:
    """The file itself or its largest overview with at most ``max_pixels``."""
    with rasterio.open(geotiff) as raster:
        factors = [1, *raster.overviews(1)]
        sizes = [-(-raster.width // f) * -(-raster.height // f) for f in factors]
    level = next((i for i, size in enumerate(sizes) if size <= max_pixels), len(sizes) - 1)
    return rasterio.open(geotiff) if level == 0 else rasterio.open(geotiff, overview_level=level - 1)


def _strips(raster: rasterio.DatasetReader) -> Iterator[tuple[Window, NDArray[np.uint8]]]:
    """All pixels, (4, rows, width) at a time."""
    for row in range(0, raster.height, BLOCK_PX):
        window = Window(0, row, raster.width, min(BLOCK_PX, raster.height - row))
        yield window, raster.read(window=window)


def _verify(path: Path, total: NDArray[np.uint64]) -> None:
    """Read back: GDAL's TIFF writer does not report a disk that is full."""
    found = np.zeros(4, np.uint64)
    with rasterio.open(path) as raster:
        for _, pixels in _strips(raster):
            found += pixels.sum(axis=(1, 2), dtype=np.uint64)
    if not np.array_equal(found, total):
        raise RasterioError("pixels are missing from what was written")


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """A name beside ``path`` for a file that is gone afterwards."""
    scratch = path.with_name(f".{path.name}.scratch")
    try:
        yield scratch
    finally:
        scratch.unlink(missing_ok=True)


@contextmanager
def _gdal(path: Path) -> Iterator[None]:
    """Bounded block cache, no side-car files; what GDAL cannot write becomes one line."""
    try:
        with rasterio.Env(GDAL_CACHEMAX=CACHE_MB, GDAL_PAM_ENABLED=False, GDAL_NUM_THREADS=2):
            yield
    except (RasterioError, CPLE_BaseError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: cannot be written ({reason}); free some space or choose another folder"
        ) from None
