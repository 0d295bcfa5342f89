"""Reading of the position tags of one photograph, with the reason for each tag that is not used.

The maker's own tags come before Exif's: they have more digits and the altitude of an RTK receiver. Sources:
CIPA DC-008-2019 (Exif 2.32), section 4.6.6; DJI's and Pix4D's XMP names as cameras write them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL.ExifTags import GPS

from slam.core.geodesy import MAX_ALTITUDE_M, METRES_PER_DEGREE, metres_per_degree_east, position_fault
from slam.core.height_systems import ELLIPSOID, SEA_LEVEL, UNKNOWN
from slam.io.photos.tag_values import number, numbers, positive, text
from slam.io.photos.xmp import Xmp

LATITUDE_NAMES = ("GpsLatitude", "GPSLatitude", "Latitude")
LONGITUDE_NAMES = ("GpsLongitude", "GpsLongtitude", "GPSLongitude", "Longitude")
"""Makers' XMP names; older DJI cameras write the second one of the longitude."""
RTK_SOLUTIONS = {0: "without a position", 16: "single", 34: "float", 50: "fixed"}
"""Solutions by DJI's ``RtkFlag``. A single or float one has errors of decimetres to metres."""
_LIKE_WGS_84 = re.compile(r"(WGS|ITRF|ETRS|NAD83|GDA|JGD|CGCS|NZGD|SIRGAS|GRS80)", re.IGNORECASE)
"""Begin of names of datums, without blanks and hyphens, from which WGS 84 differs by two metres at most."""
HEIGHT_ABOVE_TAKEOFF_STD_M = 1.0
"""Assumed standard deviation of a height above the take-off, which drones have from their barometer and which
no tag and no subtitle states."""
UNSIGNED = "so the sign is unknown"
"""Words that mark a fault of a missing letter N, S, E or W."""


@dataclass(frozen=True)
class PhotoPosition:
    """Position tags of one photograph."""

    latitude_deg: float | None = None
    longitude_deg: float | None = None
    altitude_m: float | None = None
    exif_altitude_m: float | None = None
    """Exif altitude; ``altitude_m`` may come from the maker's own tag."""
    exif_gap_deg: tuple[float, float] | None = None
    """Differences in latitude and longitude of Exif from the maker's tags, beyond Exif's rounding; None where
    one of both is missing."""
    std_m: tuple[float, float, float] | None = None
    """Standard deviations of east, north, up that the camera states."""
    rtk: str = ""
    """Solution of the RTK receiver: a value of `RTK_SOLUTIONS`; empty if the tags do not contain it."""
    height_system: str = ""
    """The vertical datum of ``altitude_m``, as `slam.core.height_systems` names it; empty if no tag tells."""
    is_of_camera: bool = False
    """Whether it is the place of the camera itself, with the offset of the antenna taken into account."""
    height_above_takeoff_m: float | None = None
    unsigned_deg: tuple[float, float] | None = None
    """Latitude and longitude without their signs, where only letters are missing."""
    datum: str = ""
    """Exif's name of the datum of its latitude and longitude where these are used; empty for WGS 84 and those
    close to it."""
    letters: str = ""
    """The letters that Exif has of N, S, E, W."""
    faults: tuple[str, ...] = ()
    """Tags that are not used, each with the reason."""

    @property
    def is_known(self) -> bool:
        """Whether latitude and longitude are known."""
        return self.latitude_deg is not None

    def apart_m(self, latitude_deg: float, longitude_deg: float) -> float:
        """Return the distance to another place along the ground, to about 1 %; NaN without a position."""
        if self.latitude_deg is None or self.longitude_deg is None:
            return float("nan")
        north_m = (latitude_deg - self.latitude_deg) * METRES_PER_DEGREE
        east_deg = (longitude_deg - self.longitude_deg + 180) % 360 - 180
        return float(np.hypot(north_m, east_deg * metres_per_degree_east(self.latitude_deg)))


def read_position(gps: dict[int, Any], xmp: Xmp) -> PhotoPosition:
    """Return the position in Exif's GPS directory ``gps`` and the XMP packet."""
    faults: list[str] = []
    lat, lon = (
        number(xmp.text("drone", *LATITUDE_NAMES)),
        number(xmp.text("drone", *LONGITUDE_NAMES)),
    )
    unsigned, letters, gap_deg, datum = None, "", None, ""
    if lat is None or lon is None or (reason := position_fault(lat, lon)):
        if lat is not None and lon is not None and any((lat, lon)):
            faults.append(f"XMP: {reason}")
        lat, lon, unsigned, letters = _exif_place(gps, faults)
        datum = text(gps.get(GPS.GPSMapDatum))[:40]
    else:
        gap_deg = _exif_gap_deg(gps, lat, lon)
    exif_altitude = number(gps.get(GPS.GPSAltitude))
    if exif_altitude is not None and _below_sea(gps.get(GPS.GPSAltitudeRef)):
        exif_altitude = -exif_altitude
    exif_altitude = _plausible("Exif's GPSAltitude", exif_altitude, faults)
    altitude = _plausible("AbsoluteAltitude", number(xmp.text("drone", "AbsoluteAltitude")), faults)
    takeoff = _plausible("RelativeAltitude", number(xmp.text("drone", "RelativeAltitude")), faults)
    return PhotoPosition(
        latitude_deg=lat,
        longitude_deg=lon,
        altitude_m=exif_altitude if altitude is None else altitude,
        exif_altitude_m=exif_altitude,
        exif_gap_deg=gap_deg,
        std_m=_stated_std(gps, xmp),
        height_system=_height_system(gps, xmp, altitude is not None),
        rtk=RTK_SOLUTIONS.get(int(_flag(xmp.text("drone", "RtkFlag"))), ""),
        height_above_takeoff_m=takeoff,
        unsigned_deg=unsigned,
        datum="" if _LIKE_WGS_84.match(re.sub(r"[^A-Za-z0-9]", "", datum)) else datum,
        letters=letters,
        faults=tuple(faults),
    )


def _exif_gap_deg(gps: dict[int, Any], lat_deg: float, lon_deg: float) -> tuple[float, float] | None:
    """Return how far Exif's latitude and longitude lie from others; 0 within the rounding of the seconds."""
    exif_lat, exif_lon, _, _ = _exif_place(gps, [])
    if exif_lat is None or exif_lon is None:
        return None
    gaps = []
    for tag, gap_deg in ((GPS.GPSLatitude, exif_lat - lat_deg), (GPS.GPSLongitude, exif_lon - lon_deg)):
        finest = max(getattr(part, "denominator", 1) * 60**k for k, part in enumerate(gps[tag]))
        gaps.append(gap_deg if abs(gap_deg) > 1 / finest else 0.0)
    return gaps[0], gaps[1]


def _exif_place(
    gps: dict[int, Any], faults: list[str]
) -> tuple[float | None, float | None, tuple[float, float] | None, str]:
    """Return latitude, longitude, both without signs if only letters are missing, and the letters."""
    if GPS.GPSLatitude not in gps and GPS.GPSLongitude not in gps:
        return None, None, None, ""
    lat = _sexagesimal("GPSLatitude", gps.get(GPS.GPSLatitude), faults)
    lon = _sexagesimal("GPSLongitude", gps.get(GPS.GPSLongitude), faults)
    if text(gps.get(GPS.GPSStatus)).upper() == "V":
        faults.append("GPSStatus is V (the receiver had no valid fix)")
        return None, None, None, ""
    if lat is None or lon is None:
        return None, None, None, ""
    if reason := position_fault(lat, lon):
        faults.append(reason)
        return None, None, None, ""
    north = text(gps.get(GPS.GPSLatitudeRef))[:1].upper()
    east = text(gps.get(GPS.GPSLongitudeRef))[:1].upper()
    letters = (north if north in "NS" else "") + (east if east in "EW" else "")
    if len(letters) < 2:
        missing = [
            f"{name} ({meant})"
            for name, letter, meant in (
                ("GPSLatitudeRef", north, "N or S"),
                ("GPSLongitudeRef", east, "E or W"),
            )
            if letter not in letters or not letter
        ]
        verb = "is" if len(missing) == 1 else "are"
        faults.append(f"{' and '.join(missing)} {verb} missing, {UNSIGNED}")
        return None, None, (lat, lon), letters
    return -lat if north == "S" else lat, -lon if east == "W" else lon, None, letters


def _sexagesimal(name: str, value: Any, faults: list[str]) -> float | None:
    """Return degrees from degrees, minutes, seconds; None with a fault if they are not known to a second."""
    parts = list(value) if isinstance(value, (tuple, list)) else []
    if len(parts) == 3 and number(parts[2]) is None and (minutes := number(parts[1])) is not None:
        if minutes == int(minutes):
            faults.append(f"{name} has no valid seconds: it is known to 1 minute (1.9 km) only")
            return None
        parts[2] = 0.0  # minutes with decimals hold the seconds
    angle = numbers(parts, 3)
    if angle is None or (angle < 0).any() or (angle[1:] > 60).any():
        faults.append(f"{name} is not in degrees, minutes and seconds")
        return None
    return float(angle @ [1, 1 / 60, 1 / 3600])


def _plausible(name: str, altitude_m: float | None, faults: list[str]) -> float | None:
    if altitude_m is None or abs(altitude_m) <= MAX_ALTITUDE_M:
        return altitude_m
    faults.append(f"{name} {altitude_m:g} m is beyond {MAX_ALTITUDE_M / 1e3:g} km")
    return None


def _stated_std(gps: dict[int, Any], xmp: Xmp) -> tuple[float, float, float] | None:
    """Return the standard deviations that the camera states: RTK's, Pix4D's, or Exif's horizontal error."""
    east, north, up = (_std(xmp.text("drone", f"RtkStd{axis}")) for axis in ("Lon", "Lat", "Hgt"))
    if east is None or north is None or up is None:
        # Skydio has the second names.
        east = north = _std(xmp.text("camera", "GPSXYAccuracy") or xmp.text("drone", "GpsHorizontalAccuracy"))
        up = _std(xmp.text("camera", "GPSZAccuracy") or xmp.text("drone", "GpsVerticalAccuracy"))
    if east is None or north is None or up is None:
        radius = _std(gps.get(GPS.GPSHPositioningError))
        if radius is None:
            return None
        # A radius that holds 63 % is the root of the sum of both variances. The vertical error of satellite
        # positions is about twice the horizontal one.
        east = north = radius / float(np.sqrt(2))
        up = 2 * east
    return east, north, up


def _std(value: Any) -> float | None:
    found = positive(value)
    return found if found is not None and found <= MAX_ALTITUDE_M else None


def _height_system(gps: dict[int, Any], xmp: Xmp, by_maker: bool) -> str:
    """Return the vertical datum of the altitude, the maker's or Exif's, as far as the tags tell.

    DJI's ``RtkAlt`` is a height over the ellipsoid (DJI, Onboard SDK: Flight Altitude); its other types
    depend on the pressure of the air. The values 2 and 3 of GPSAltitudeRef, of Exif 3.0, name sea level. The
    values 0 and 1 do so in Exif 2, and the ellipsoid in Exif 3.0, and many cameras write them of either.
    """
    if by_maker:
        return ELLIPSOID if text(xmp.text("drone", "AltitudeType")).lower() == "rtkalt" else UNKNOWN
    return SEA_LEVEL if _reference(gps.get(GPS.GPSAltitudeRef)) in (2, 3) else UNKNOWN


def _below_sea(reference: Any) -> bool:
    """Return whether GPSAltitudeRef is 1 (below the reference), or 3 of Exif 3.0 (below sea level)."""
    return _reference(reference) in (1, 3)


def _reference(tag: Any) -> float | None:
    return tag[0] if isinstance(tag, bytes) and len(tag) == 1 else number(tag)


def _flag(value: Any) -> float:
    """Return the number of a flag; -1, which none has, without one."""
    found = number(value)
    return -1.0 if found is None else found
