"""Small photographs with the tags that cameras and drones write, made for the tests."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.TiffImagePlugin import IFDRational

from slam.core.flight import Flight

SIZE = (64, 48)
XMP_TAG = 700
NADIR = {"GimbalYawDegree": "+0.00", "GimbalPitchDegree": "-90.00", "GimbalRollDegree": "+0.00"}


def sexagesimal(degrees: float) -> tuple[IFDRational, ...]:
    value = Fraction(abs(degrees)).limit_denominator(10**9)
    whole = int(value)
    minutes = int((value - whole) * 60)
    seconds = ((value - whole) * 60 - minutes) * 60
    return IFDRational(whole), IFDRational(minutes), IFDRational(round(seconds * 10**6), 10**6)


def jpeg(
    *,
    size=SIZE,
    place=(30.1705, -98.0902),
    altitude=320.5,
    time="2024:05:06 07:08:09",
    make="Acme",
    model="Mapper 1",
    tags=None,
    gps=None,
    drone=None,
    camera=None,
    elements=False,
    container="JPEG",
    seed=0,
    pixels=None,
    packet=None,
    deep=False,
) -> bytes:
    """A picture file; None leaves a tag out, ``drone`` and ``camera`` are XMP names and values.

    ``packet`` is a whole XMP packet instead, and ``deep`` gives grey pixels of 12 bits, for a TIFF. The
    pixels are noise by default.
    """
    if packet is None and (drone or camera):
        packet = xmp(drone or {}, camera or {}, elements=elements)
    exif = Image.Exif()
    exif[Base.Make], exif[Base.Model] = make, model
    inner = exif.get_ifd(IFD.Exif)
    if time is not None:
        inner[Base.DateTimeOriginal] = time
    inner.update(tags or {})
    where = exif.get_ifd(IFD.GPSInfo)
    if place is not None:
        lat, lon = place
        where[GPS.GPSLatitudeRef], where[GPS.GPSLatitude] = "N" if lat >= 0 else "S", sexagesimal(lat)
        where[GPS.GPSLongitudeRef], where[GPS.GPSLongitude] = "E" if lon >= 0 else "W", sexagesimal(lon)
        if altitude is not None:
            where[GPS.GPSAltitudeRef] = b"\x01" if altitude < 0 else b"\x00"
            where[GPS.GPSAltitude] = IFDRational(round(abs(altitude) * 1000), 1000)
    where.update(gps or {})
    if container == "TIFF":  # Pillow writes a TIFF's inner directories only where they are values
        exif[IFD.Exif], exif[IFD.GPSInfo] = dict(inner), dict(where)
        if packet is not None:
            exif[XMP_TAG] = packet
    if pixels is None:
        pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    out = io.BytesIO()
    pixels = pixels[..., 0].astype(np.uint16) << 4 if deep else pixels
    Image.fromarray(pixels).save(out, container, exif=exif)
    data = out.getvalue()
    return with_xmp(data, packet) if packet is not None and container == "JPEG" else data


def xmp(drone: dict[str, str], camera: dict[str, str], *, elements: bool = False) -> bytes:
    named = {f"drone-dji:{k}": v for k, v in drone.items()} | {f"Camera:{k}": v for k, v in camera.items()}
    attributes = "" if elements else "".join(f' {k}="{v}"' for k, v in named.items())
    inside = "".join(f"<{k}>{v}</{k}>" for k, v in named.items()) if elements else ""
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'
        f' xmlns:Camera="http://pix4d.com/camera/1.0/"{attributes}>{inside}</rdf:Description>'
        '</rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def with_xmp(data: bytes, packet: bytes) -> bytes:
    """A JPEG with the packet as its first segment."""
    body = b"http://ns.adobe.com/xap/1.0/\0" + packet
    return data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:]


def fill(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def strip(count=3, **kwargs) -> dict[str, bytes]:
    """``count`` photographs 2 s apart, going north."""
    return {
        f"P{k}.jpg": jpeg(
            **({"time": f"2024:05:06 07:08:{2 * k:02d}", "place": (30 + k * 1e-4, -98.0), "seed": k} | kwargs)
        )
        for k in range(count)
    }


def warned(flight: Flight, *words: str) -> list[str]:
    """The warnings that hold all of the words."""
    return [line for line in flight.warnings if all(word in line for word in words)]
