"""In which coordinates and over which level the rasters of a map lie, in words."""

from __future__ import annotations

from slam.core.estimate import Estimate
from slam.core.geodesy import UPS_NORTH, UPS_SOUTH, utm_epsg
from slam.core.height_systems import height_system_text
from slam.core.units import axis_names, unit

_GEOID_M = 107
"""Largest distance of sea level from the ellipsoid (EGM2008; National Geospatial-Intelligence Agency)."""


def at(estimate: Estimate, x: float, y: float) -> str:
    """Return a place of the map in words; no zero has a sign."""
    m, names = unit(estimate.metric), axis_names(estimate.origin is not None)
    return ", ".join(
        f"{axis} = {round(value, 2) + 0.0:.2f} {m}" for axis, value in zip(names, (x, y), strict=True)
    )


def plane_text(estimate: Estimate) -> str:
    """Return the coordinate system of mosaic.tif and elevation.tif."""
    if not estimate.metric:
        return "no coordinate system: lengths are multiples of the camera's mean height"
    origin = estimate.origin
    if origin is None:
        return "local metres without a place on Earth, so no EPSG code"
    code = utm_epsg(origin.latitude_deg, origin.longitude_deg)
    grid = "UPS" if code in (UPS_NORTH, UPS_SOUTH) else "UTM"
    return (
        f"metres east and north of {origin.text} (azimuthal equidistant about that point, on WGS 84; no "
        "EPSG code names this plane, the files hold its definition); "
        f"for {grid}, EPSG:{code}, take mosaic_crs.tif and elevation_crs.tif, or run slam export --to geotiff"
    )


def datum_text(estimate: Estimate) -> str:
    """Return where heights begin: the datum of elevation.tif and of z."""
    origin = estimate.origin
    if origin is None:
        return (
            "count from the ground below the first keyframe (where the map begins), not from sea "
            "level and not from the ellipsoid"
        )
    floor = f"{origin.altitude_m + estimate.floor_z_m:.1f} m"
    if not estimate.altitude_known:
        return "count from the floor; no altitude is recorded, so nothing tells where that lies above the sea"
    if estimate.height_system:
        return f"count from the floor at {floor} over {height_system_text(estimate.height_system)}"
    if estimate.follows_control_points:
        return f"count from the floor at {floor} in the height system of the control points"
    return (
        f"count from the floor at {floor} of the GPS altitudes as recorded; whether those are "
        "above the WGS 84 ellipsoid or above sea level, the recording does not say (the two differ by up "
        f"to {_GEOID_M} m)"
    )
