"""Change of the position in an XMP packet, which many programs prefer to that of Exif.

Only values that the packet has are replaced, by the names that the reader of photographs knows.
"""

from __future__ import annotations

import re

import numpy as np

from slam.io.exports.camera_position import CameraPosition
from slam.io.photos.position import LATITUDE_NAMES, LONGITUDE_NAMES
from slam.io.photos.xmp import family_of

_NAMESPACE = re.compile(rb"xmlns:([\w.-]+)\s*=\s*[\"']([^\"']*)[\"']")
"""Declaration of a prefix, and the address of its namespace."""
_EXIF = "http://ns.adobe.com/exif/"
"""Begin of the address of Adobe's own names, which the reader leaves to Exif."""


def with_position(packet: bytes, at: CameraPosition) -> bytes:
    """Return the packet with the position, and with its standard deviations if they are known."""
    for family, values in _values(at).items():
        for prefix in _prefixes(packet, family):
            for name, value in values.items():
                packet = _replaced(packet, prefix + b":" + name.encode(), value.encode())
    return packet


def _values(at: CameraPosition) -> dict[str, dict[str, str]]:
    """Return the text of each name by family."""
    latitude, longitude = f"{at.latitude_deg:.9f}", f"{at.longitude_deg:.9f}"
    drone = {**dict.fromkeys(LATITUDE_NAMES, latitude), **dict.fromkeys(LONGITUDE_NAMES, longitude)}
    camera: dict[str, str] = {}
    if at.std_m is not None:
        east, north, up = (f"{std:.5f}" for std in at.std_m)
        across = f"{at.horizontal_std_m:.5f}"
        drone |= {"RtkStdLon": east, "RtkStdLat": north, "RtkStdHgt": up}
        drone |= {"GpsHorizontalAccuracy": across, "GpsVerticalAccuracy": up}
        camera = {"GPSXYAccuracy": across, "GPSZAccuracy": up}
    exif = {
        "GPSLatitude": _minutes(at.latitude_deg, "NS"),
        "GPSLongitude": _minutes(at.longitude_deg, "EW"),
    }
    if np.isfinite(at.altitude_m):
        drone["AbsoluteAltitude"] = f"{at.altitude_m:.4f}"
        exif["GPSAltitude"] = f"{round(abs(at.altitude_m) * 10_000)}/10000"
        exif["GPSAltitudeRef"] = str(int(at.altitude_m < 0))
    return {"drone": drone, "camera": camera, "exif": exif}


def _minutes(angle_deg: float, letters: str) -> str:
    """Return an angle as "DDD,MM.mmmmmmmK", the form of XMP's own names."""
    units = round(abs(angle_deg) * 60 * 10**7)
    whole, rest = divmod(units, 60 * 10**7)
    return f"{whole},{rest / 10**7:.7f}{letters[angle_deg < 0]}"


def _prefixes(packet: bytes, family: str) -> set[bytes]:
    declared = [(prefix, uri.decode("utf-8", "replace")) for prefix, uri in _NAMESPACE.findall(packet)]
    return {prefix for prefix, uri in declared if family == _family(uri)}


def _family(uri: str) -> str | None:
    return "exif" if uri.startswith(_EXIF) else family_of(uri)


def _replaced(packet: bytes, name: bytes, value: bytes) -> bytes:
    """Replace the value of an attribute or of an element."""
    attribute = rb"(\s" + re.escape(name) + rb"\s*=\s*)(?:\"[^\"]*\"|'[^']*')"
    element = rb"(<" + re.escape(name) + rb"(?:\s[^>]*)?>)[^<]*(?=</" + re.escape(name) + rb"\s*>)"
    packet = re.sub(attribute, lambda found: found[1] + b'"' + value + b'"', packet)
    return re.sub(element, lambda found: found[1] + value, packet)
