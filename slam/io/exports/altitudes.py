"""Altitudes of the ground: a raster of the heights over the floor of a map, moved into its height system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.errors import CRSError

from slam.core.estimate import Estimate
from slam.core.geodesy import geodetic_from_enu
from slam.core.height_systems import ELLIPSOID
from slam.io.survey_system import height_unit_m


def with_heights(crs: CRS, height_system: str) -> CRS:
    """Return a horizontal system joined with a system of heights; as it is where they cannot be joined.

    GeoTIFF has no projection with heights over its ellipsoid (OGC 19-008r4, GeoTIFF 1.1).
    """
    if CRS.from_string(height_system).is_geographic:
        return CRS.from_epsg(4979) if (crs.to_epsg(), height_system) == (4326, ELLIPSOID) else crs
    try:
        return CRS.from_string(f"EPSG:{crs.to_epsg()}+{height_system.removeprefix('EPSG:')}")
    except CRSError:
        return crs


def write_altitudes(elevation: Path, target: Path, estimate: Estimate) -> None:
    """Write the altitudes of the ground in the plane of the map, block by block; NaN where none is known.

    Up is that of the map's origin, from whose plane the Earth falls away, by 8 cm in 1 km. Values are in the
    unit of the height system of ``estimate``, which is known.
    """
    assert estimate.origin is not None
    unit_m = height_unit_m(CRS.from_string(estimate.height_system))
    with rasterio.open(elevation) as heights:
        profile = {**heights.profile, "driver": "GTiff", "count": 1, "compress": "deflate", "zlevel": 1}
        with rasterio.open(target, "w", **profile) as raster:
            raster.set_band_description(1, "altitude")
            for _, window in heights.block_windows(1):
                over_floor_m = heights.read(1, window=window).astype(float)
                rows, cols = np.mgrid[: window.height, : window.width] + 0.5
                x = heights.transform.c + heights.transform.a * (cols + window.col_off)
                y = heights.transform.f + heights.transform.e * (rows + window.row_off)
                w_p = np.stack([x, y, over_floor_m + estimate.floor_z_m], axis=-1).reshape(-1, 3)
                altitude_m = geodetic_from_enu(w_p, estimate.origin)[2].reshape(over_floor_m.shape)
                raster.write((altitude_m / unit_m).astype(np.float32), 1, window=window)
