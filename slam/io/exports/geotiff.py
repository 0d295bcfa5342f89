"""The rasters of a map in a named coordinate system, for GIS.

The map's own system is azimuthal equidistant about its origin. The rasters are resampled once into UTM (UPS
at the poles) or another system of the EPSG registry.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import ArrayLike, NDArray
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.errors import CRSError, RasterioError
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform
from rasterio.windows import Window

from slam.core.errors import InputError
from slam.core.estimate import Estimate
from slam.core.geodesy import GeoOrigin, geodetic_from_enu, utm_epsg
from slam.io.datum_accuracy import datum_accuracy_m
from slam.io.exports.altitudes import with_heights, write_altitudes
from slam.io.exports.exported_map import ExportedMap
from slam.io.geotiff import BLOCK_PX, CACHE_MB, COG, height_tags
from slam.io.survey_system import has_three_axes

_CODES = re.compile(r"EPSG:\d+(\+\d+)?", re.IGNORECASE)
"""The code of a system, or those of a plane and of heights."""
UTM, NO_SYSTEM = "utm", "none"
"""Words for a system, beside ``EPSG:`` and a number: the zone of the map, and no rasters in any."""
ELEVATION, ALTITUDE = "elevation.tif", "altitude.tif"
"""Heights over the floor, and altitudes of the ground in the height system of the map, made of these."""
RASTERS = {
    "mosaic.tif": Resampling.cubic,
    "mosaic_quality.tif": Resampling.nearest,
    ELEVATION: Resampling.nearest,
    ALTITUDE: Resampling.nearest,
}
"""Files and their resampling. Heights keep their values: none lies between roof and ground."""
_PIECE_PX = 2 * BLOCK_PX
"""Side of the squares that are resampled one after the other: 21 MB for the five bands of an elevation. Line
by line, the blocks of a large mosaic leave the cache before the next line needs them, and are decoded again.
"""
MOST_STRETCH = 0.01
"""Largest change of a length by a projection that is not said. In its zone UTM changes lengths by 0.1 % at
most (Snyder 1987, section 8), and projections of countries by less."""
_AWAY_M = 10.0
"""Length on the ground that is compared."""
_LINES = 21
"""Lines each way of a grid on a raster, whose steps are compared in the other system."""
_MOST_UNEVEN = 2.0
"""Longest over shortest step of a raster's grid. Where a projection breaks, one step is far longer. Near a
pole of the projection the scale changes too: at this ratio, equal pixels keep one of 2 x 2 in a part of the
map."""


def write(exported: ExportedMap, target: Path) -> tuple[str, ...]:
    """Write the rasters that the map has.

    Raises ``InputError`` for a map without rasters, and as `write_rasters` does.
    """
    folder = exported.folder
    files = [] if folder is None else rasters_in(folder, exported.estimate)
    if folder is None or not files:
        raise InputError("--to geotiff: the map has no rasters; map the flight without --no-mosaic")
    target.mkdir(exist_ok=True)
    return write_rasters(exported.estimate, folder, {name: target / name for name in files}, exported.crs)


def rasters_in(folder: Path, estimate: Estimate) -> list[str]:
    """Return the names of the rasters that can be made of an output folder.

    Altitudes need a height system that is known.
    """
    has_altitude = (folder / ELEVATION).is_file() and bool(estimate.height_system)
    return [name for name in RASTERS if (folder / name).is_file() or (name == ALTITUDE and has_altitude)]


def write_rasters(
    estimate: Estimate, folder: Path, targets: Mapping[str, Path], system: str
) -> tuple[str, ...]:
    """Write rasters of ``folder`` in a coordinate system to ``targets``, by their names, all or none.

    Return one line each about the system, lengths that it changes, and where heights begin. ``estimate`` has
    a place on Earth. Earlier files stay until all are complete. Raises ``InputError`` for an unknown system,
    and a place that the system does not hold.
    """
    assert estimate.origin is not None
    crs = coordinate_system(system, estimate.origin)
    tags = height_tags(estimate)
    with TemporaryDirectory(prefix=".crs-", dir=next(iter(targets.values())).parent) as work:
        sources = {name: folder / (ELEVATION if name == ALTITUDE else name) for name in targets}
        for path in sources.values():
            _refuse_break(path, crs, system)
        made = {name: Path(work) / name for name in targets}
        for name, path in made.items():
            source, named = sources[name], crs
            try:
                if name == ALTITUDE:
                    source, named = Path(work) / f"own_{name}", with_heights(crs, estimate.height_system)
                    write_altitudes(sources[name], source, estimate)
                _reproject(source, path, crs, RASTERS[name], tags, named)
            except (RasterioError, CPLE_BaseError) as error:
                reason = " ".join(str(error).split())
                raise InputError(
                    f"--crs {system}: {name} cannot be brought into it ({reason}); give the system of the "
                    "map's region"
                ) from None
        for name, path in made.items():
            path.replace(targets[name])
    return (
        f"coordinate system: {crs.to_string()}",
        *_stretch_note(crs, estimate.origin),
        *_datum_note(crs, estimate.origin),
        f"heights are over {_floor(tags)}",
    )


def _floor(tags: dict[str, str]) -> str:
    """Return where heights begin, by the metadata of `height_tags`."""
    altitude, datum = tags.get("FLOOR_ALTITUDE_M"), tags["VERTICAL_DATUM"]
    if altitude is None:
        return datum
    level = f"over {datum}" if "VERTICAL_CRS" in tags else f"in the {datum}"
    return f"the map's floor, at {float(altitude):.2f} m {level}"


def coordinate_system(name: str, origin: GeoOrigin) -> CRS:
    """Return the system of ``name`` for a map about ``origin``.

    Raises ``InputError`` for an unknown name, and a system that does not hold the origin.
    """
    crs = named_system(name)
    if crs is None:
        return CRS.from_epsg(utm_epsg(origin.latitude_deg, origin.longitude_deg))
    if not np.isfinite(_transformed("EPSG:4326", crs, [origin.longitude_deg], [origin.latitude_deg])).all():
        raise InputError(f"--crs {name}: it does not hold {origin.text}; give the system of the map's region")
    return crs


def named_system(name: str) -> CRS | None:
    """Return the system ``EPSG:n``; None for ``utm``, which depends on the place.

    Raises ``InputError`` for another name, and for a system of no plane.
    """
    if name.lower() == UTM:
        return None
    try:
        found = CRS.from_string(name.upper()) if _CODES.fullmatch(name) else None
    except CRSError:
        found = None
    if found is None:
        raise InputError(f"--crs {name}: no known coordinate system; give utm, or EPSG: and its number")
    if not (found.is_projected or found.is_geographic):
        raise InputError(
            f"--crs {name}: a system of heights, of space or of one site, in which no map can be drawn; give "
            "utm, or EPSG: and the number of a projection"
        )
    if plane := _plane_of_system_with_heights(found):
        raise InputError(
            f"--crs {name}: a system with heights, and those of rasters count from the map's floor; give "
            f"the system of its plane ({plane}). Altitudes are written too where their vertical datum is "
            "known; to convert them to another one, use a program with a grid of the geoid, such as gdalwarp"
        )
    return found


def _plane_of_system_with_heights(crs: CRS) -> str:
    """Return the plane below a system of places and heights; empty for a system without them."""
    system = crs.to_dict(projjson=True)
    if "components" in system:
        plane = system["components"][0]
        code = plane.get("id", {}).get("code")
        return f"EPSG:{code}, {plane['name']}" if code else str(plane["name"])
    return f"{system['name']} in two dimensions" if has_three_axes(system) else ""


def _transformed(source: CRS | str, crs: CRS, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Return points in another system (n, 2), easting or longitude first; inf where it does not hold them."""
    try:
        return np.column_stack(transform(source, crs, np.ravel(x).tolist(), np.ravel(y).tolist()))
    except CPLE_BaseError:
        return np.full((np.size(x), 2), np.inf)


def _refuse_break(path: Path, crs: CRS, system: str) -> None:
    """Raise ``InputError`` for a raster that does not lie in one piece, at about one scale, in ``crs``."""
    with rasterio.open(path) as raster:
        west, south, east, north = raster.bounds
        x, y = np.meshgrid(np.linspace(west, east, _LINES), np.linspace(south, north, _LINES))
        places = _transformed(raster.crs, crs, x, y).reshape(_LINES, _LINES, 2)
    is_whole = bool(np.isfinite(places).all())
    for axis in (0, 1) if is_whole else ():
        steps = np.linalg.norm(np.diff(places, axis=axis), axis=2)
        is_whole &= bool(steps.max() < _MOST_UNEVEN * steps.min())
    if not is_whole:
        raise InputError(
            f"--crs {system}: {path.name} lies across or beside an edge of this system, such as 180 degrees "
            "of longitude or a pole; give utm, or another system of the map's region"
        )


def _stretch_note(crs: CRS, origin: GeoOrigin) -> tuple[str, ...]:
    """Return a note about a projection in which a metre on the ground, at the origin, is not a metre."""
    if not crs.is_projected:
        return ()
    latitude_deg, longitude_deg, _ = geodetic_from_enu([[0.0, 0.0, 0.0], [_AWAY_M, 0.0, 0.0]], origin)
    here, away = _transformed("EPSG:4326", crs, longitude_deg, latitude_deg)
    metre = float(np.linalg.norm(away - here)) * crs.linear_units_factor[1] / _AWAY_M
    if not abs(metre - 1) > MOST_STRETCH:
        return ()
    return (
        f"a metre on the ground is {metre:.3g} m in this projection here: measure no lengths in it, or take "
        "utm",
    )


def _datum_note(crs: CRS, origin: GeoOrigin) -> tuple[str, ...]:
    """Return a note about a system that is tied to WGS 84 worse than a survey."""
    std_m = datum_accuracy_m(crs, origin.longitude_deg, origin.latitude_deg)
    if std_m == 0:
        return ()
    good = "of unknown accuracy" if np.isnan(std_m) else f"good to {std_m:g} m"
    return (
        f"places are brought from WGS 84 into {crs.to_string()} by a transformation {good}: all may be off "
        "by that in this system, alike; compare one with a point surveyed in it",
    )


def _reproject(
    source: Path, target: Path, crs: CRS, resampling: Resampling, tags: dict[str, str], named: CRS
) -> None:
    """Resample a raster piece by piece, and say where its heights begin; a plain one is left beside it.

    ``named`` is the system that the file names: ``crs``, with that of its heights if it holds altitudes.

    Raises ``RasterioError`` where not all of it reaches the disk.
    """
    plain = target.with_name(f"plain_{target.name}")
    with rasterio.Env(GDAL_CACHEMAX=CACHE_MB, GDAL_PAM_ENABLED=False, GDAL_NUM_THREADS=2):
        with rasterio.open(source) as raster, WarpedVRT(raster, crs=crs, resampling=resampling) as warped:
            profile = {
                "driver": "GTiff", "width": warped.width, "height": warped.height, "count": warped.count,
                "dtype": warped.dtypes[0], "nodata": warped.nodata,
                "crs": named, "transform": warped.transform,
                "tiled": True, "blockxsize": BLOCK_PX, "blockysize": BLOCK_PX, "compress": "deflate",
                "zlevel": 1, "num_threads": "ALL_CPUS", "bigtiff": "IF_SAFER",
            }  # fmt: skip
            written = []
            with rasterio.open(plain, "w", **profile) as made:
                made.colorinterp = raster.colorinterp
                made.descriptions = raster.descriptions
                made.update_tags(**tags)
                for window in _pieces(warped.width, warped.height):
                    pixels = warped.read(window=window)
                    made.write(pixels, window=window)
                    written.append(_digest(pixels))
        rasterio.shutil.copy(plain, target, **COG, bigtiff="IF_SAFER")
        with rasterio.open(target) as made:  # GDAL's TIFF writer does not report a full disk
            found = [_digest(made.read(window=window)) for window in _pieces(made.width, made.height)]
    if found != written:
        raise RasterioError("pixels are missing from what was written")


def _pieces(width: int, height: int) -> Iterator[Window]:
    for row in range(0, height, _PIECE_PX):
        for col in range(0, width, _PIECE_PX):
            yield Window(col, row, min(_PIECE_PX, width - col), min(_PIECE_PX, height - row))


def _digest(pixels: NDArray[np.generic]) -> bytes:
    return sha256(np.ascontiguousarray(pixels).data).digest()
