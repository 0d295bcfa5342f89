"""Reading of the tags of one photograph: camera, time, position and attitude.

Angles stay in the maker's convention (degrees, yaw clockwise from north); ``slam.io.gimbal`` converts them to
the axes of the flight. A tag that is absent, not finite or out of range is ``None``. Sources: CIPA
DC-008-2019 (Exif 2.32), sections 4.6.3 to 4.6.6; DJI's XMP names as its cameras write them.
"""

from __future__ import annotations

import mmap
import re
import warnings
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base

from slam.core.errors import InputError
from slam.io.content import unreadable_reason
from slam.io.photos.lens_tags import LensTags, read_lens
from slam.io.photos.position import PhotoPosition, read_position
from slam.io.photos.tag_values import number, numbers, positive, text
from slam.io.photos.xmp import Xmp, parse_xmp
from slam.io.picture_headers import MAX_PIXELS
from slam.io.tiff import MAGIC as TIFF_MAGIC
from slam.io.tiff import XMP_TAG, tiff_header

Angles = tuple[float, float, float]
"""Yaw, pitch, roll in degrees."""
Velocity3 = tuple[float, float, float]
"""North, east, down in m/s."""

_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
"""Millimetres per FocalPlaneResolutionUnit: inch, centimetre and, as an extension of the standard, millimetre
and micrometre.
"""

_THERMAL_SOURCES = ("InfraredCamera",)
"""Values of DJI's ``ImageSource`` of a thermal camera. Of its other cameras, ``BandName`` names the band."""


@dataclass(frozen=True)
class PhotoTags:
    """Tags of one photograph."""

    size_px: tuple[int, int]
    """(width, height) of the stored pixels."""
    is_turned: bool = False
    """Whether a viewer turns or mirrors the stored pixels, by Exif's orientation."""
    make: str = ""
    model: str = ""
    serial: str = ""
    """Serial number of the camera, or of the vehicle that has it."""
    original_size_px: tuple[float, float] | None = None
    """(width, height) at the exposure, if the tags contain it."""
    focal_mm: float | None = None
    focal_35mm: float | None = None
    """Focal length with the same diagonal view on 35 mm film [mm]."""
    digital_zoom: float | None = None
    """Factor by which the camera enlarged the middle of the picture; None without it."""
    sensor_px_per_mm: float | None = None
    """Original pixels per millimetre of the sensor."""
    calibrated_focal_px: float | None = None
    """Calibrated focal length at the original size."""
    dewarp: tuple[float, ...] | None = None
    """fx, fy, cx, cy (relative to the centre), k1, k2, p1, p2, k3 at the original size."""
    lens: LensTags | None = None
    """Calibration by Pix4D's names."""
    lens_name: str = ""
    """Which lens of the camera, if it has several."""
    band: str = ""
    """Part of the spectrum; empty if the tags do not contain it."""
    dewarped: bool = False
    """Whether the camera has already removed the distortion."""
    camera_time_ns: int | None = None
    """Time of the camera's calendar clock since 1970, without its time zone."""
    utc_offset_ns: int | None = None
    """Offset to subtract from the time for UTC."""
    gps_time_ns: int | None = None
    """Time of the satellites since 1970, UTC."""
    position: PhotoPosition = field(default_factory=PhotoPosition)
    gimbal: Angles | None = None
    """Angles of DJI, Parrot and Skydio: pitch 0 is the horizon, -90 straight down."""
    mount: Angles | None = None
    """Angles of Pix4D's names. By its definition pitch 0 is straight down and +90 the horizon ahead, but some
    makers store the angles of the gimbal."""
    airframe: Angles | None = None
    """Attitude of the vehicle."""
    speed_ned_m_s: Velocity3 | None = None
    """Velocity of the vehicle north, east and down; None without it."""
    attitude_faults: tuple[str, ...] = ()
    """Why tags of an attitude are not used."""
    xmp_damaged: bool = False


def read_tags(path: Path) -> PhotoTags:
    """Read the tags of a JPEG, PNG or TIFF without decoding pixels.

    Raises ``InputError`` if the file is not such a picture, is damaged or is truncated.
    """
    try:
        if path.stat().st_size == 0:
            raise InputError("empty file")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of damaged tags, which count as absent
            size, exif, packet, complete = _header(path)
            tags = {**exif, **exif.get_ifd(IFD.Exif)}
            gps = dict(exif.get_ifd(IFD.GPSInfo))
    except InputError:
        raise
    except PermissionError as error:
        raise InputError("no permission to read it") from error
    except Image.DecompressionBombError as error:
        raise InputError(f"more than {MAX_PIXELS // 10**6} million pixels") from error
    except Exception as error:  # Pillow raises any exception for a damaged file
        raise InputError(unreadable_reason(path)) from error
    if size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"more than {MAX_PIXELS // 10**6} million pixels")
    if not complete:
        raise InputError("cut short or damaged")
    xmp = parse_xmp(packet.encode() if isinstance(packet, str) else bytes(packet or b""))
    return PhotoTags(
        size,
        **_camera(tags, xmp),
        **_time(tags, gps),
        position=read_position(gps, xmp),
        speed_ned_m_s=_speed(xmp),
        **_attitude_angles(xmp),
    )


def _header(path: Path) -> tuple[tuple[int, int], Image.Exif, str | bytes, bool]:
    """Return size [px], Exif tags, XMP packet, and whether the container is complete."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[:4] in TIFF_MAGIC:  # Pillow's own reader refuses many kinds of pixels
            header = tiff_header(file)
            exif = header.exif
            exif.get_ifd(IFD.Exif), exif.get_ifd(IFD.GPSInfo)  # these are read from the open file
            packet = exif.get(XMP_TAG, b"")
            return (
                header.size_px,
                exif,
                bytes(packet) if isinstance(packet, (bytes, tuple)) else b"",
                header.end <= len(data),
            )
        with Image.open(file, formats=("JPEG", "PNG")) as image:
            exif = image.getexif()
            exif.get_ifd(IFD.Exif), exif.get_ifd(IFD.GPSInfo)
            complete = data.rfind(b"IEND") > 0 if image.format == "PNG" else _has_end_of_image(data)
            return image.size, exif, image.info.get("xmp", b""), complete


def _has_end_of_image(data: mmap.mmap) -> bool:
    """Return whether a JPEG is complete."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xDA:
            # Only the end-of-image marker after the scan counts, as thumbnails before it have their own.
            return data.rfind(b"\xff\xd9", at) > 0
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return False


def _camera(tags: dict[int, Any], xmp: Xmp) -> dict[str, Any]:
    unit_mm = _MM_PER_UNIT.get(int(number(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    per_unit = positive(tags.get(Base.FocalPlaneXResolution))
    dewarp = [number(v) for v in re.split(r"[,;\s]+", xmp.text("drone", "DewarpData"))[1:]]
    width, height = positive(tags.get(Base.ExifImageWidth)), positive(tags.get(Base.ExifImageHeight))
    px_per_mm = per_unit / unit_mm if per_unit and unit_mm else None
    known = len(dewarp) >= 9 and all(v is not None for v in dewarp[:9])
    source = text(xmp.text("drone", "ImageSource"))
    return {
        "is_turned": number(tags.get(Base.Orientation)) in range(2, 9),
        "make": text(tags.get(Base.Make)),
        "model": text(tags.get(Base.Model)),
        "serial": text(tags.get(Base.BodySerialNumber))
        or text(xmp.text("drone", "CameraSerialNumber", "DroneSerialNumber")),
        "original_size_px": (width, height) if width and height else None,
        "focal_mm": positive(tags.get(Base.FocalLength)),
        "focal_35mm": positive(tags.get(Base.FocalLengthIn35mmFilm)),
        "digital_zoom": positive(tags.get(Base.DigitalZoomRatio)),
        "sensor_px_per_mm": px_per_mm,
        "calibrated_focal_px": positive(
            xmp.text("drone", "CalibratedFocalLength", "CalibratedFocalLength.X")
        ),
        "lens": read_lens(xmp, px_per_mm),
        "lens_name": text(
            xmp.text("drone", "CameraSensorModule", "ImageSource") or xmp.text("camera", "RigCameraIndex")
        ),
        "band": text(xmp.text("camera", "BandName")) or (source if source in _THERMAL_SOURCES else ""),
        "dewarp": tuple(v for v in dewarp[:9] if v is not None) if known else None,
        "dewarped": bool(number(xmp.text("drone", "DewarpFlag"))),
        "xmp_damaged": xmp.damaged,
    }


def _time(tags: dict[int, Any], gps: dict[int, Any]) -> dict[str, Any]:
    camera, offset = None, None
    for date, fraction, zone in (
        (Base.DateTimeOriginal, Base.SubsecTimeOriginal, Base.OffsetTimeOriginal),
        (Base.DateTimeDigitized, Base.SubsecTimeDigitized, Base.OffsetTimeDigitized),
    ):
        camera = _calendar_ns(text(tags.get(date)))
        if camera is not None:
            digits = re.match(r"\d{1,9}", text(tags.get(fraction)))
            camera += int(digits[0].ljust(9, "0")) if digits else 0
            offset = _utc_offset_ns(text(tags.get(zone)))
            break
    clock = numbers(gps.get(GPS.GPSTimeStamp), 3)
    midnight = _calendar_ns(text(gps.get(GPS.GPSDateStamp)) + " 00:00:00")
    satellite = None
    if clock is not None and midnight is not None and 0 <= clock @ [3600, 60, 1] <= 86401:
        satellite = midnight + round(float(clock @ [3600, 60, 1]) * 1e9)
    return {"camera_time_ns": camera, "utc_offset_ns": offset, "gps_time_ns": satellite}


def _attitude_angles(xmp: Xmp) -> dict[str, Any]:
    faults: list[str] = []
    return {
        # Parrot and Skydio have DJI's convention under other names.
        "gimbal": _angles(xmp, "drone", faults, "GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
        or _angles(xmp, "drone", faults, "CameraYawDegree", "CameraPitchDegree", "CameraRollDegree")
        or _angles(xmp, "drone", faults, *_nested("CameraOrientationNED")),
        "mount": _angles(xmp, "camera", faults, "Yaw", "Pitch", "Roll"),
        "airframe": _angles(xmp, "drone", faults, "FlightYawDegree", "FlightPitchDegree", "FlightRollDegree")
        or _angles(xmp, "drone", faults, *_nested("VehicleOrientationNED")),
        "attitude_faults": tuple(faults),
    }


def _speed(xmp: Xmp) -> Velocity3 | None:
    """Return DJI's velocity of the vehicle north, east and down [m/s].

    Source: DJI, P4 Multispectral Image Processing Guide (2020), section I: ground speed northern, eastern and
    vertical. Vertical speeds of DJI's flight controllers are positive downward.
    """
    north, east, down = (number(xmp.text("drone", f"Flight{axis}Speed")) for axis in "XYZ")
    return None if north is None or east is None else (north, east, down or 0.0)


def _nested(structure: str) -> list[str]:
    return [f"{structure}.{name}" for name in ("Yaw", "Pitch", "Roll")]


def _angles(xmp: Xmp, family: Any, faults: list[str], *names: str) -> Angles | None:
    """Return yaw, pitch and roll; None, with a fault if they are present, where yaw or pitch is no angle."""
    texts = [xmp.text(family, name) for name in names]
    found = [number(tag) for tag in texts]
    for name, tag, value, largest in zip(names, texts, found, (360, 180), strict=False):
        if tag and (value is None or abs(value) > largest):
            faults.append(f"{name} is {text(tag)[:40]}, no angle in degrees")
            return None
    yaw, pitch, roll = found
    if yaw is None or pitch is None:
        return None
    return yaw, pitch, roll if roll is not None and abs(roll) <= 180 else 0.0


def _calendar_ns(text: str) -> int | None:
    """Return nanoseconds from 1970 to "YYYY:MM:DD hh:mm:ss"; None for the zeros of a clock that was never
    set.
    """
    match = re.match(r"(\d{4})[:-](\d\d)[:-](\d\d)[ T](\d\d):(\d\d):(\d\d)", text)
    if match is None:
        return None
    try:
        since = datetime.strptime(" ".join(match.groups()), "%Y %m %d %H %M %S") - datetime(1970, 1, 1)
    except ValueError:
        return None
    # A year after 2200 is an error, and its nanoseconds could exceed 64 bits.
    return since // timedelta(seconds=1) * 10**9 if timedelta(0) <= since < timedelta(days=84000) else None


def _utc_offset_ns(text: str) -> int | None:
    match = re.fullmatch(r"([+-])(\d\d):(\d\d)|Z", text)
    if match is None:
        return None
    if match[1] is None:
        return 0
    return (1 if match[1] == "+" else -1) * (int(match[2]) * 60 + int(match[3])) * 60 * 10**9
