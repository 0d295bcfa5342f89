"""Coordinates on Earth: WGS 84 geodetic, Earth-centred (ECEF) and local east-north-up.

The conversions are exact on the ellipsoid (no flat-Earth approximation), so distances between points are
preserved. Altitude is the height above the ellipsoid. A height above sea level may replace it, as the
difference is nearly constant over a flight. Frames: ``e`` Earth-centred Earth-fixed, ``w`` east-north-up at
the origin.

Source: National Geospatial-Intelligence Agency, WGS 84, NGA.STND.0036 (2014); Bowring, "Transformation from
spatial to geographical coordinates", Survey Review 181 (1976).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

EQUATOR_M = 6378137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2 - FLATTENING)

MAX_ALTITUDE_M = 5e4
"""Altitudes beyond are no altitudes of an aircraft: a wrong unit or a damaged value."""

METRES_PER_DEGREE = math.radians(EQUATOR_M)
"""Metres per degree of longitude at the equator. A degree of latitude is 110.6 to 111.7 km, within 1 % of it:
enough for a standard deviation."""

UTM_NORTH_END_DEG, UTM_SOUTH_END_DEG = 84.0, -80.0
"""Latitudes beyond which UTM has no zones."""
UPS_NORTH, UPS_SOUTH = 5041, 5042
"""EPSG codes of the universal polar stereographic grids on WGS 84 with easting first."""

_BOWRING_STEPS = 5
"""Number of iterations. Each gains about three digits near Earth, so that five reach the last bit from any
altitude in use.
"""


@dataclass(frozen=True)
class GeoOrigin:
    """Geodetic position (WGS 84) of the origin of a flight's local east-north-up world."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """0 where none is known."""
    altitude_known: bool = True
    """Whether an altitude is known."""
    height_system: str = ""
    """Its vertical datum, as `slam.core.height_systems` names it; empty if nobody states it."""

    @property
    def text(self) -> str:
        """Latitude and longitude to about a millimetre, for a person."""
        return (
            f"{abs(self.latitude_deg):.8f}° {'N' if self.latitude_deg >= 0 else 'S'}, "
            f"{abs(self.longitude_deg):.8f}° {'E' if self.longitude_deg >= 0 else 'W'}"
        )


def position_fault(latitude_deg: float, longitude_deg: float) -> str:
    """Return why two finite numbers are no position; empty if they are one."""
    if abs(latitude_deg) > 90:
        return f"latitude {latitude_deg:g} degrees is beyond 90"
    if abs(longitude_deg) > 180:
        return f"longitude {longitude_deg:g} degrees is beyond 180"
    if (latitude_deg, longitude_deg) == (0, 0):
        return "latitude and longitude are both 0 (no fix)"
    return ""


def utm_epsg(latitude_deg: float, longitude_deg: float) -> int:
    """Return the EPSG code on WGS 84 of the UTM zone of a place; beyond 84 N or 80 S that of UPS.

    The exceptions around Norway are left out. Source: NGA.SIG.0012 (2014), The universal grids, sections 7 to
    10: zones of 6 degrees, and the polar stereographic grids where UTM ends.
    """
    if latitude_deg > UTM_NORTH_END_DEG or latitude_deg < UTM_SOUTH_END_DEG:
        return UPS_NORTH if latitude_deg > 0 else UPS_SOUTH
    zone = int((longitude_deg + 180) // 6) % 60 + 1
    return (32600 if latitude_deg >= 0 else 32700) + zone


def ecef_from_geodetic(latitude_deg: ArrayLike, longitude_deg: ArrayLike, altitude_m: ArrayLike) -> Array:
    """Return Earth-centred coordinates in metres; arguments are broadcast. (n,) each -> (n, 3)."""
    lat, lon = np.radians(np.asarray(latitude_deg, float)), np.radians(np.asarray(longitude_deg, float))
    alt = np.asarray(altitude_m, float)
    across = EQUATOR_M / np.sqrt(1 - ECCENTRICITY_2 * np.sin(lat) ** 2)
    from_axis = (across + alt) * np.cos(lat)
    x, y = from_axis * np.cos(lon), from_axis * np.sin(lon)
    return np.stack(np.broadcast_arrays(x, y, (across * (1 - ECCENTRICITY_2) + alt) * np.sin(lat)), axis=-1)


def geodetic_from_ecef(e_p_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Return latitude [deg], longitude [deg] and altitude [m] of Earth-centred points. (n, 3) -> three (n,).

    It is Bowring's iteration on the parametric latitude, exact to rounding (2e-9 m near the ground).
    """
    x, y, z = np.moveaxis(np.asarray(e_p_m, float), -1, 0)
    from_axis = np.hypot(x, y)
    parametric = np.arctan2(z, (1 - FLATTENING) * from_axis)
    lat = parametric
    for _ in range(_BOWRING_STEPS):
        lat = np.arctan2(
            z + ECCENTRICITY_2 / (1 - FLATTENING) * EQUATOR_M * np.sin(parametric) ** 3,
            from_axis - ECCENTRICITY_2 * EQUATOR_M * np.cos(parametric) ** 3,
        )
        parametric = np.arctan2((1 - FLATTENING) * np.sin(lat), np.cos(lat))
    # The projection on the ellipsoid's normal is accurate at the poles and at the equator.
    height = (
        from_axis * np.cos(lat) + z * np.sin(lat) - EQUATOR_M * np.sqrt(1 - ECCENTRICITY_2 * np.sin(lat) ** 2)
    )
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), height


def enu_from_geodetic(
    latitude_deg: ArrayLike, longitude_deg: ArrayLike, altitude_m: ArrayLike, origin: GeoOrigin
) -> Array:
    """Return east, north, up in metres from ``origin``. (n,) each -> (n, 3).

    If the altitude is NaN, up is NaN, and east and north are those at the origin's altitude (an error of 1.6
    cm for each 100 m of height and km of distance).
    """
    lat, lon, alt = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(a, float)) for a in (latitude_deg, longitude_deg, altitude_m))
    )
    known = np.isfinite(alt)
    e_p = ecef_from_geodetic(lat, lon, np.where(known, alt, origin.altitude_m))
    w_p = (e_p - _origin_in_ecef(origin)) @ _ecef_R_enu(origin)
    w_p[~known, 2] = np.nan
    return w_p


def geodetic_from_enu(w_p_m: ArrayLike, origin: GeoOrigin) -> tuple[Array, Array, Array]:
    """Return latitude [deg], longitude [deg] and altitude [m] of east-north-up points (n, 3), each (n,)."""
    w_p = np.asarray(w_p_m, float).reshape(-1, 3)
    return geodetic_from_ecef(w_p @ _ecef_R_enu(origin).T + _origin_in_ecef(origin))


def enu_R_enu(to: GeoOrigin, origin: GeoOrigin) -> Array:
    """Return the rotation (3, 3) from east-north-up axes at ``origin`` to those at another place.

    North and the vertical turn by about 0.01 degrees with each kilometre.
    """
    return np.asarray(_ecef_R_enu(to).T @ _ecef_R_enu(origin))


def _origin_in_ecef(origin: GeoOrigin) -> Array:
    return ecef_from_geodetic(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)


def _ecef_R_enu(origin: GeoOrigin) -> Array:
    """Return the rotation (3, 3) whose columns are east, north and up at the origin."""
    lat, lon = np.radians(origin.latitude_deg), np.radians(origin.longitude_deg)
    (sin_lat, cos_lat), (sin_lon, cos_lon) = (np.sin(lat), np.cos(lat)), (np.sin(lon), np.cos(lon))
    east = [-sin_lon, cos_lon, 0.0]
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    up = [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]
    return np.column_stack([east, north, up])


def metres_per_degree_east(latitude_deg: float) -> float:
    """Return the length of a degree of longitude at a latitude, on a sphere; never 0."""
    return METRES_PER_DEGREE * max(float(np.cos(np.radians(latitude_deg))), 1e-6)
