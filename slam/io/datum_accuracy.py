"""How well a coordinate system is tied to WGS 84: the accuracy of the transformation of its datum.

Source: EPSG's database, in the copy that PROJ has.
"""

from __future__ import annotations

import math
import os
import sqlite3
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rasterio.crs import CRS

_CODES = """
    SELECT code FROM geodetic_crs
    WHERE auth_name = 'EPSG' AND type = 'geographic 2D' AND datum_auth_name = 'EPSG' AND datum_code IN (
        :datum, (SELECT datum_code FROM geodetic_crs WHERE auth_name = 'EPSG' AND code = :base)
    )
"""
"""Systems in degrees of a datum, which is named itself, or by one of them."""
_ACCURACY = f"""
    SELECT MIN(o.accuracy) FROM helmert_transformation o
    JOIN usage u ON u.object_table_name = 'helmert_transformation'
        AND u.object_auth_name = o.auth_name AND u.object_code = o.code
    JOIN extent e ON e.auth_name = u.extent_auth_name AND e.code = u.extent_code
    WHERE o.auth_name = 'EPSG' AND NOT o.deprecated AND o.source_crs_code IN ({_CODES})
        AND o.target_crs_code = '4326' AND :latitude BETWEEN e.south_lat AND e.north_lat
        AND CASE WHEN e.west_lon <= e.east_lon THEN :longitude BETWEEN e.west_lon AND e.east_lon
            ELSE :longitude >= e.west_lon OR :longitude <= e.east_lon END
"""
"""Accuracy of the best transformation to WGS 84 by seven parameters whose area holds a place. An area across
the meridian of 180 degrees ends at a smaller longitude than it begins."""
_EQUATOR_M, _INVERSE_FLATTENING = 6378137.0, 298.25722
"""Ellipsoid of WGS 84 and of GRS 80, which differ by 0.1 mm at the poles."""


def datum_accuracy_m(crs: CRS, longitude_deg: float, latitude_deg: float) -> float:
    """Return the accuracy of the transformation between a system and WGS 84 at a place; NaN if not known.

    It is 0 for WGS 84 itself, and for datums that are taken to be the same, such as ETRS89 and NAD83: a GPS
    with a base station in them has their positions. It is that of the best transformation without a grid, as
    no grids come with this program. It is not known of parameters that the system itself states
    (``+towgs84``), nor of an ellipsoid without a datum, whose coordinates are taken as they are.
    """
    system = crs.to_dict(projjson=True)
    plane = system["components"][0] if "components" in system else system
    if plane["type"] == "BoundCRS":
        if any(each["value"] for each in plane["transformation"]["parameters"] if "value" in each):
            return math.nan
        plane = plane["source_crs"]
    base = plane.get("base_crs", plane)
    datum = base.get("datum") or base.get("datum_ensemble") or {}
    names = {"base": _epsg(base), "datum": _epsg(datum)}
    if not any(names.values()):
        return 0.0 if _is_of_wgs84(datum) else math.nan
    return _best_m(names, _is_of_wgs84(datum), longitude_deg, latitude_deg)


def _epsg(named: Mapping[str, Any]) -> str:
    code = named.get("id", {})
    return str(code["code"]) if code.get("authority") == "EPSG" else ""


def _best_m(
    names: Mapping[str, str], same_ellipsoid: bool, longitude_deg: float, latitude_deg: float
) -> float:
    from rasterio.warp import transform

    path = _database()
    if path is None:
        return math.nan
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as database:
        keys = {**names, "longitude": longitude_deg, "latitude": latitude_deg}
        (best,) = database.execute(_ACCURACY, keys).fetchone()
        codes = [code for (code,) in database.execute(_CODES, keys)]
    here = [longitude_deg], [latitude_deg]
    if same_ellipsoid and codes:
        there = transform(f"EPSG:{codes[0]}", "EPSG:4326", *here)
        if np.allclose(there, here, rtol=0, atol=1e-9):
            return 0.0
    return math.nan if best is None else float(best)


def _database() -> Path | None:
    """Return PROJ's copy of EPSG's database, searched as PROJ does: the folders that the environment names,
    that of rasterio's wheel, and those of a system; None where it is in none of them."""
    import rasterio

    named = os.environ.get("PROJ_DATA") or os.environ.get("PROJ_LIB") or ""
    folders = [Path(each).absolute() for each in named.split(os.pathsep) if each]
    folders.append(Path(rasterio.__file__).absolute().parent / "proj_data")
    folders += [Path(prefix, "share/proj") for prefix in (sys.prefix, "/usr/local", "/usr")]
    return next((path for folder in folders if (path := folder / "proj.db").is_file()), None)


def _is_of_wgs84(datum: Mapping[str, Any]) -> bool:
    """Return whether a datum has the ellipsoid of WGS 84, or GRS 80."""
    ellipsoid = datum.get("ellipsoid", {})
    axis_m, flattening = ellipsoid.get("semi_major_axis"), ellipsoid.get("inverse_flattening", math.nan)
    return bool(axis_m == _EQUATOR_M and abs(flattening - _INVERSE_FLATTENING) < 1e-5)
