"""The rasters of a map in a named coordinate system, for GIS.

The map's own system is azimuthal equidistant about its origin. The rasters are resampled once into UTM or
another system of the EPSG registry.
"""

from __future__ import annotations

from pathlib import Path

import rasterio
import rasterio.shutil
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.vrt import WarpedVRT

from slam.core.errors import InputError
from slam.core.geodesy import GeoOrigin
from slam.io.exports.exported_map import ExportedMap
from slam.io.geotiff import height_tags

RASTERS = {
    "mosaic.tif": Resampling.cubic,
    "mosaic_quality.tif": Resampling.nearest,
    "elevation.tif": Resampling.nearest,
}
"""Files and their resampling. Heights keep their values: none lies between roof and ground."""
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
        f"heights are over the map's floor, at {float(tags['FLOOR_ALTITUDE_M']):.2f} m in the "
        f"{tags['VERTICAL_DATUM']}",
    )


def coordinate_system(name: str, origin: GeoOrigin) -> CRS:
    """Return the system ``utm`` of the origin's zone, or ``EPSG:n``. Raises ``InputError`` for another name.

    Source: Snyder 1987, Map projections, a working manual, section 8 (zones of 6 degrees).
    """
    if name.lower() == "utm":
        zone = int((origin.longitude_deg + 180) // 6) % 60 + 1
        return CRS.from_epsg((NORTH_ZONES if origin.latitude_deg >= 0 else SOUTH_ZONES) + zone)
    kind, _, number = name.partition(":")
    try:
        if kind.lower() == "epsg" and number.isdigit():
            return CRS.from_epsg(int(number))
    except CRSError:
        pass
    raise InputError(f"--crs {name}: no known coordinate system; give utm, or EPSG: and its number")


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
