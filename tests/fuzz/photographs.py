"""A small photograph of each container, with the EXIF and XMP tags that drones write."""

from __future__ import annotations

import io

from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from PIL.PngImagePlugin import PngInfo
from PIL.TiffImagePlugin import IFDRational

from tests.slam.io.photos.photo_files import NADIR, SIZE, jpeg, with_xmp, xmp

DRONE = NADIR | {
    "AbsoluteAltitude": "+10",
    "RelativeAltitude": "+1",
    "DewarpData": "2020-01-01;60,60,0,0,0,0,0,0,0",
}
CAMERA = {"Yaw": "10", "Pitch": "-90", "Roll": "0", "GPSXYAccuracy": "0.1"}
TAGS = {
    Base.SubsecTimeOriginal: "12",
    Base.OffsetTimeOriginal: "+01:00",
    Base.FocalLength: IFDRational(9, 2),
    Base.FocalPlaneXResolution: IFDRational(10**6, 61),
    Base.FocalPlaneResolutionUnit: 2,
    Base.FocalLengthIn35mmFilm: 25,
    Base.ExifImageWidth: 64,
    Base.ExifImageHeight: 48,
}
XMP_TAG = 700


def photograph(container: str, second: int = 0) -> bytes:
    """A JPEG, PNG or TIFF with all tags that are read; of one colour, so that most of it is tags."""
    gps = {GPS.GPSDateStamp: "2024:05:06", GPS.GPSHPositioningError: IFDRational(2)}
    tagged = jpeg(tags=TAGS, gps=gps, time=f"2024:05:06 07:08:2{second}")
    with Image.open(io.BytesIO(tagged)) as held:
        exif = held.getexif()
    packet, out = xmp(DRONE, CAMERA), io.BytesIO()
    picture = Image.new("RGB", SIZE, (90, 120, 60))
    if container == "JPEG":
        picture.save(out, container, exif=exif)
        return with_xmp(out.getvalue(), packet)
    if container == "PNG":
        text = PngInfo()
        text.add_itxt("XML:com.adobe.xmp", packet.decode())
        picture.save(out, container, exif=exif, pnginfo=text)
        return out.getvalue()
    whole = Image.Exif()  # Pillow writes a TIFF's inner directories only where they are values
    whole.update({tag: value for tag, value in exif.items() if tag not in (IFD.Exif, IFD.GPSInfo)})
    whole[XMP_TAG] = packet
    for inner in (IFD.Exif, IFD.GPSInfo):
        whole.get_ifd(inner).update(exif.get_ifd(inner))
        whole[inner] = dict(whole.get_ifd(inner))
    picture.convert("1").save(out, container, exif=whole)
    return out.getvalue()
