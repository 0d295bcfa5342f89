"""The rasters of a map in a named coordinate system, for GIS.

The map's own system is azimuthal equidistant about its origin. The rasters are resampled once into UTM or
another system of the EPSG registry.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
import rasterio.shutil
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin, geodetic_from_enu
from slam.io.exports.exported_map import ExportedMap
from slam.io.geotiff import height_tags

RASTERS = {
    "mosaic.tif": Resampling.cubic,
    "mosaic_quality.tif": Resampling.nearest,
    "elevation.tif": Resampling.nearest,
}
"""Files and their resampling. Heights keep their values: none lies between roof and ground."""
MOST_STRETCH = 0.01
"""Largest change of a length by a projection that is not said. In its zone UTM changes lengths by 0.1 % at
most (Snyder 1987, section 8), and projections of countries by less."""
_AWAY_M = 10.0
"""Length on the ground that is compared."""
NORTH_ZONES, SOUTH_ZONES = 32600, 32700
"""EPSG codes of UTM on WGS 84, to which the number of the zone is added."""


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the rasters that the map has.

    Raises ``InputError`` for an unknown coordinate system, a map without rasters, and a place that the system
    does not hold.
    """
    estimate = exported.estimate
    assert estimate.origin is not None
    folder = exported.folder
    files = [name for name in RASTERS if folder is not None and (folder / name).is_file()]
    if folder is None or not files:
        raise InputError("--to geotiff: the map has no rasters; map the flight without --no-mosaic")
    crs = coordinate_system(exported.crs, estimate.origin)
    tags = height_tags(estimate)
    target.mkdir(exist_ok=True)
    for name in files:
        try:
            _reproject(folder / name, target / name, crs, RASTERS[name], tags)
        except (RasterioError, CPLE_BaseError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"--crs {exported.crs}: {name} cannot be brought into it ({reason}); give the system of the "
                "map's region"
            ) from None
    return (
        f"coordinate system: {crs.to_string()}",
        *_stretch_note(crs, estimate.origin),
        f"heights are over {_floor(tags)}",
    )


def _floor(tags: dict[str, str]) -> str:
    """Return where heights begin, by the metadata of `height_tags`."""
    altitude, datum = tags.get("FLOOR_ALTITUDE_M"), tags["VERTICAL_DATUM"]
    return datum if altitude is None else f"the map's floor, at {float(altitude):.2f} m in the {datum}"


def coordinate_system(name: str, origin: GeoOrigin) -> CRS:
    """Return the system ``utm`` of the origin's zone, or ``EPSG:n``. Raises ``InputError`` for another name.

    Source: Snyder 1987, Map projections, a working manual, section 8 (zones of 6 degrees).
    """
    if name.lower() == "utm":
        zone = int((origin.longitude_deg + 180) // 6) % 60 + 1
        return CRS.from_epsg((NORTH_ZONES if origin.latitude_deg >= 0 else SOUTH_ZONES) + zone)
    kind, _, number = name.partition(":")
    try:
        found = CRS.from_epsg(int(number)) if kind.lower() == "epsg" and number.isdigit() else None
    except CRSError:
        found = None
    if found is None:
        raise InputError(f"--crs {name}: no known coordinate system; give utm, or EPSG: and its number")
    if not (found.is_projected or found.is_geographic):
        raise InputError(
            f"--crs {name}: a system of heights, of space or of one site, in which no map can be drawn; give "
            "utm, or EPSG: and the number of a projection"
        )
    return found


def _stretch_note(crs: CRS, origin: GeoOrigin) -> tuple[str, ...]:
    """Return a note about a projection in which a metre on the ground, at the origin, is not a metre."""
    if not crs.is_projected:
        return ()
    latitude_deg, longitude_deg, _ = geodetic_from_enu([[0.0, 0.0, 0.0], [_AWAY_M, 0.0, 0.0]], origin)
    x, y = transform("EPSG:4326", crs, longitude_deg.tolist(), latitude_deg.tolist())
    metre = float(np.hypot(x[1] - x[0], y[1] - y[0])) * crs.linear_units_factor[1] / _AWAY_M
    if not abs(metre - 1) > MOST_STRETCH:
        return ()
    return (
        f"a metre on the ground is {metre:.3g} m in this projection here: measure no lengths in it, or take "
        "utm",
    )


def _reproject(source: Path, target: Path, crs: CRS, resampling: Resampling, tags: dict[str, str]) -> None:
    """Resample a raster block by block, and say where its heights begin."""
    plain = target.with_name(f".{target.name}.scratch")
    with (
        rasterio.Env(GDAL_CACHEMAX=64, GDAL_PAM_ENABLED=False),
        rasterio.open(source) as raster,
        WarpedVRT(raster, crs=crs, resampling=resampling) as warped,
    ):
        rasterio.shutil.copy(
            warped, plain, driver="GTiff", tiled="YES", compress="DEFLATE", bigtiff="IF_SAFER"
        )
    with rasterio.open(plain, "r+") as raster:
        raster.update_tags(**tags)
    rasterio.shutil.copy(plain, target, driver="COG", compress="DEFLATE", bigtiff="IF_SAFER")
    plain.unlink()
