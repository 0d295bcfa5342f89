"""Position of a camera on Earth, and its Exif tags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL.ExifTags import GPS

from slam.io.exports.tiff_tags import Value, bytes_value, rational_value, text_value

REPLACED = frozenset(
    (GPS.GPSStatus, GPS.GPSMeasureMode, GPS.GPSDOP, GPS.GPSSatellites, GPS.GPSHPositioningError)
)
"""Tags that describe the receiver's fix, not the new position."""

_SECOND_PARTS, _METRE_PARTS = 10**6, 10**4


@dataclass(frozen=True)
class CameraPosition:
    """Geodetic position of a camera."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """NaN where none is known."""
    std_m: tuple[float, float, float] | None
    """Standard deviations of east, north, up; None if they are not known."""

    @property
    def horizontal_std_m(self) -> float | None:
        """Root mean square of the standard deviations of east and north."""
        return None if self.std_m is None else float(np.hypot(*self.std_m[:2]) / np.sqrt(2))

    def exif(self) -> dict[int, Value]:
        """Return the tags of the GPS directory.

        ``GPSHPositioningError`` is the root of the sum of both horizontal variances.
        """
        tags = {
            GPS.GPSVersionID: bytes_value(b"\2\3\0\0"),
            GPS.GPSLatitudeRef: text_value("S" if self.latitude_deg < 0 else "N"),
            GPS.GPSLatitude: _sexagesimal(self.latitude_deg),
            GPS.GPSLongitudeRef: text_value("W" if self.longitude_deg < 0 else "E"),
            GPS.GPSLongitude: _sexagesimal(self.longitude_deg),
            GPS.GPSMapDatum: text_value("WGS-84"),
        }
        if np.isfinite(self.altitude_m):
            tags[GPS.GPSAltitudeRef] = bytes_value(b"\1" if self.altitude_m < 0 else b"\0")
            tags[GPS.GPSAltitude] = _metres(abs(self.altitude_m))
        if self.std_m is not None:
            tags[GPS.GPSHPositioningError] = _metres(float(np.hypot(*self.std_m[:2])))
        return {int(tag): value for tag, value in tags.items()}


def _sexagesimal(angle_deg: float) -> Value:
    """Return degrees, minutes and seconds; a microsecond of arc is 0.03 mm."""
    seconds = round(abs(angle_deg) * 3600 * _SECOND_PARTS)
    minutes, seconds = divmod(seconds, 60 * _SECOND_PARTS)
    degrees, minutes = divmod(minutes, 60)
    return rational_value((degrees, 1), (minutes, 1), (seconds, _SECOND_PARTS))


def _metres(length_m: float) -> Value:
    return rational_value((round(length_m * _METRE_PARTS), _METRE_PARTS))
