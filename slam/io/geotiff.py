"""Files of a mosaic: a Cloud-Optimised GeoTIFF with overviews, and a PNG with a world file.

Both are written from tiles, with memory bounded by GDAL's block cache. The affine of a GeoTIFF refers to the
outer corner of the first pixel, a world file to its centre (ESRI, World files for raster datasets).

The GeoTIFF contains a fingerprint of the inputs of each block and a digest of its pixels. A later mosaic
reuses blocks with equal fingerprints, if they were not edited since.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType

import cv2
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
from slam.core.estimate import Estimate
from slam.core.geodesy import GeoOrigin
from slam.core.height_systems import height_system_text
from slam.io.atomic import atomic_file

BLOCK_PX = 512
CACHE_MB = 64
LOCAL_METRES = 'LOCAL_CS["local metres",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
"""Coordinate system of a plane in metres without a position on Earth."""
FINGERPRINTS_TAG = "LEMNISCATE_BLOCKS"
"""Metadata item of the GeoTIFF: JSON map of a fingerprint to row, column and digest of the pixels."""

_RGBA = {
    "count": 4, "dtype": "uint8", "photometric": "RGB", "alpha": "non-premultiplied", "BIGTIFF": "IF_SAFER",
}  # fmt: skip
COG = {
    "driver": "COG", "compress": "DEFLATE", "level": 2, "predictor": "YES", "blocksize": BLOCK_PX,
    "overview_resampling": "AVERAGE", "num_threads": "ALL_CPUS",
}  # fmt: skip
"""Level 6 takes twice as long and saves 3 %."""


@dataclass(frozen=True)
class Grid:
    """Position of the pixels of a north-up raster in the world."""

    west_m: float
    north_m: float
    """Position of the outer corner of the first pixel."""
    gsd_m: float
    width: int
    height: int
    origin: GeoOrigin | None = None
    """Position of x = y = 0 on Earth, x to the east and y to the north; None for a local plane."""
    metric: bool = True
    """Whether lengths are in metres; else they are in a unit of the map."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Return the west, east, south and north bounds."""
        east_m = self.west_m + self.width * self.gsd_m
        return self.west_m, east_m, self.north_m - self.height * self.gsd_m, self.north_m

    @property
    def affine(self) -> Affine:
        """Return the transform from (column, row) of a pixel corner to (x, y)."""
        return Affine(self.gsd_m, 0.0, self.west_m, 0.0, -self.gsd_m, self.north_m)

    @property
    def crs(self) -> CRS | None:
        """Return an azimuthal equidistant system about the origin, or the local plane if there is no origin.

        Distances from the origin are true. It is None if lengths are not metres, as a GeoTIFF has no plane of
        another unit.

        The map lies on the ellipsoid: ground at altitude h is enlarged by h / 6371 km (5e-5 at 300 m).
        """
        if self.origin is None:
            return CRS.from_wkt(LOCAL_METRES) if self.metric else None
        latitude, longitude = self.origin.latitude_deg, self.origin.longitude_deg
        plain = CRS.from_proj4(
            f"+proj=aeqd +lat_0={latitude!r} +lon_0={longitude!r} +datum=WGS84 +units=m +no_defs"
        )
        name = f"azimuthal equidistant on WGS 84 about {latitude:.7f}, {longitude:.7f}"
        named = plain.to_wkt().replace('PROJCS["unknown"', f'PROJCS["{name}"', 1)
        return CRS.from_wkt(named.replace('GEOGCS["unknown"', 'GEOGCS["WGS 84"', 1))


@dataclass(frozen=True)
class Block:
    """Rectangle of rendered pixels."""

    row: int
    col: int
    rgba: NDArray[np.uint8]
    """(rows, cols, 4); alpha is 0 where nothing was seen."""
    fingerprint: str = ""
    """Fingerprint of its inputs, for `earlier_blocks`; empty if it is not to be reused."""


EarlierBlock = Callable[[str, tuple[int, int]], "NDArray[np.uint8] | None"]
"""Map of fingerprint, rows and columns to the pixels (rows, cols, 4) in a file; None if it has none."""


def height_tags(estimate: Estimate) -> dict[str, str]:
    """Return metadata that say where the heights of a map begin; none without a place on Earth."""
    if estimate.origin is None:
        return {}
    if not estimate.altitude_known:
        return {"VERTICAL_DATUM": "the map's floor: no altitude is recorded"}
    tags = {"FLOOR_ALTITUDE_M": f"{estimate.origin.altitude_m + estimate.floor_z_m:.3f}"}
    if estimate.height_system:
        level = height_system_text(estimate.height_system)
        return {**tags, "VERTICAL_DATUM": level, "VERTICAL_CRS": estimate.height_system}
    of = "control points" if estimate.follows_control_points else "recorded altitudes"
    return {**tags, "VERTICAL_DATUM": f"reference of the {of}"}


def write_geotiff(
    path: Path,
    grid: Grid,
    blocks: Iterator[Block],
    tags: Mapping[str, str] = MappingProxyType({}),
    most_pixels: int = 0,
) -> None:
    """Write a Cloud-Optimised GeoTIFF to ``path``, complete or not at all.

    Blocks first go into a plain tiled file beside it, since overviews need all of them. It is not compressed,
    as it is read only twice. A raster of at most ``most_pixels`` has no overviews: they take most time.

    Raises ``InputError`` if it cannot be written.
    """
    profile = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "crs": grid.crs,
        "transform": grid.affine, "tiled": True, "blockxsize": BLOCK_PX, "blockysize": BLOCK_PX,
        "SPARSE_OK": True, **_RGBA,
    }  # fmt: skip
    with _gdal(path), atomic_file(path) as partial, _scratch(partial) as plain:
        total, fingerprints = np.zeros(4, np.uint64), {}
        with rasterio.open(plain, "w", **profile) as raster:
            for block in blocks:
                rows, cols = block.rgba.shape[:2]
                if block.fingerprint:
                    fingerprints[block.fingerprint] = (block.row, block.col, _digest(block.rgba))
                if block.rgba[..., 3].any():
                    window = Window(block.col, block.row, cols, rows)
                    channels = np.moveaxis(block.rgba, 2, 0)
                    raster.write(channels, window=window)
                    total += _sums(channels)
            raster.update_tags(**tags, **{FINGERPRINTS_TAG: json.dumps(fingerprints)})
        overviews = "NONE" if grid.width * grid.height <= most_pixels else "AUTO"
        rasterio.shutil.copy(plain, partial, **COG, bigtiff="IF_SAFER", overviews=overviews)
        _verify(partial, total)


@contextmanager
def earlier_blocks(path: Path) -> Iterator[EarlierBlock]:
    """Yield a reader of the blocks of a GeoTIFF. It finds none if the file is missing or not ours."""
    with ExitStack() as stack:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                raster = stack.enter_context(rasterio.open(path))
            fingerprints = json.loads(raster.tags()[FINGERPRINTS_TAG])
        except (RasterioError, CPLE_BaseError, OSError, ValueError, KeyError):
            yield lambda fingerprint, shape: None
            return

        def earlier(fingerprint: str, shape: tuple[int, int]) -> NDArray[np.uint8] | None:
            try:
                row, col, digest = fingerprints[fingerprint]
                pixels = raster.read(window=Window(col, row, shape[1], shape[0]))
            except (RasterioError, CPLE_BaseError, ValueError, KeyError, TypeError):
                return None
            rgba = np.moveaxis(pixels, 0, 2)
            # The digest differs for blocks that are edited, damaged or cut off at the end of the raster.
            return rgba if _digest(rgba) == digest else None

        yield earlier


def _digest(rgba: NDArray[np.uint8]) -> str:
    hasher = sha256(repr((rgba.shape, rgba.dtype.str)).encode())
    hasher.update(np.ascontiguousarray(rgba).data)
    return hasher.hexdigest()


def write_bands(
    path: Path,
    grid: Grid,
    bands: Mapping[str, NDArray[np.float32]],
    tags: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write a Cloud-Optimised GeoTIFF of values, one band each with its description; NaN where unknown.

    The file appears complete or not at all. Raises ``InputError`` if it cannot be written.
    """
    profile = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "crs": grid.crs,
        "transform": grid.affine, "count": len(bands), "dtype": "float32", "nodata": float("nan"),
    }  # fmt: skip
    with _gdal(path), atomic_file(path) as partial, _scratch(partial) as plain:
        with rasterio.open(plain, "w", **profile) as raster:
            for number, (description, values) in enumerate(bands.items(), start=1):
                raster.write(values, number)
                raster.set_band_description(number, description)
            raster.update_tags(**tags)
        rasterio.shutil.copy(plain, partial, **COG)
        with rasterio.open(partial) as raster:
            if not np.array_equal(raster.read(), np.stack(list(bands.values())), equal_nan=True):
                raise RasterioError("pixels are missing from what was written")


def write_png(geotiff: Path, path: Path, max_pixels: int) -> float:
    """Write a PNG of a GeoTIFF of ours from its first overview with at most ``max_pixels``; return its
    m/pixel.

    The world file beside it (``.pgw``) contains the position of the centre of the first pixel.

    Raises ``InputError`` if it cannot be written.
    """
    with _gdal(path), atomic_file(path) as partial, _scratch(partial) as plain:
        with _reduced(geotiff, max_pixels) as raster:
            affine, total = raster.transform, np.zeros(4, np.uint64)
            profile = {"driver": "GTiff", "width": raster.width, "height": raster.height, "transform": affine}
            # PNG is written line by line, which takes twenty times as long from tiles as from strips.
            with rasterio.open(plain, "w", blockysize=16, **profile, **_RGBA) as strips:
                for window, pixels in _strips(raster):
                    strips.write(pixels, window=window)
                    total += _sums(pixels)
        _verify(plain, total)
        # Level 6 takes three times as long and saves 4 %.
        rasterio.shutil.copy(plain, partial, driver="PNG", zlevel=2)
    lines = (affine.a, 0.0, 0.0, affine.e, affine.c + affine.a / 2, affine.f + affine.e / 2)
    with atomic_file(path.with_suffix(".pgw")) as partial:
        partial.write_text("".join(f"{value:.12g}\n" for value in lines))
    return float(affine.a)


def _reduced(geotiff: Path, max_pixels: int) -> rasterio.DatasetReader:
    """Return the file itself or its largest overview with at most ``max_pixels``."""
    with rasterio.open(geotiff) as raster:
        factors = [1, *raster.overviews(1)]
        sizes = [-(-raster.width // f) * -(-raster.height // f) for f in factors]
    level = next((i for i, size in enumerate(sizes) if size <= max_pixels), len(sizes) - 1)
    return rasterio.open(geotiff) if level == 0 else rasterio.open(geotiff, overview_level=level - 1)


def _strips(raster: rasterio.DatasetReader) -> Iterator[tuple[Window, NDArray[np.uint8]]]:
    """Yield all pixels, (4, rows, width) at a time."""
    for row in range(0, raster.height, BLOCK_PX):
        window = Window(0, row, raster.width, min(BLOCK_PX, raster.height - row))
        yield window, raster.read(window=window)


def _sums(channels: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """Return the sum of each channel (4, rows, columns); a 64-bit float holds it exactly."""
    return np.array([cv2.sumElems(channel)[0] for channel in channels]).astype(np.uint64)


def _verify(path: Path, total: NDArray[np.uint64]) -> None:
    """Check the sums of the channels in the file, as GDAL's TIFF writer does not report a full disk."""
    found = np.zeros(4, np.uint64)
    with rasterio.open(path) as raster:
        for _, pixels in _strips(raster):
            found += _sums(pixels)
    if not np.array_equal(found, total):
        raise RasterioError("pixels are missing from what was written")


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path`` for a file that is removed afterwards."""
    scratch = path.with_name(f".{path.name}.scratch")
    try:
        yield scratch
    finally:
        scratch.unlink(missing_ok=True)


@contextmanager
def _gdal(path: Path) -> Iterator[None]:
    """Bound the block cache, suppress side-car files, and turn GDAL's errors into ``InputError``."""
    try:
        with rasterio.Env(GDAL_CACHEMAX=CACHE_MB, GDAL_PAM_ENABLED=False, GDAL_NUM_THREADS=2):
            yield
    except (RasterioError, CPLE_BaseError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: cannot be written ({reason}); free some space or choose another folder"
        ) from None
