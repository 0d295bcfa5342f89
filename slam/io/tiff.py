"""Header and pixels of a TIFF with any number type.

Pillow reads the tags, and up to four samples of up to 8 bits. GDAL reads the other kinds of pixels, packed
ones included, which Pillow refuses or shortens. Source: Adobe, TIFF 6.0 (1992), sections 8 and 19.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import IO

import numpy as np
from PIL import Image as Pillow

from slam.io.levels import Raw

MAGIC = (b"II*\0", b"MM\0*")
"""First bytes of a TIFF."""
XMP_TAG = 700
"""Tag of an XMP packet."""

_WIDTH, _HEIGHT, _BITS, _SAMPLES = 256, 257, 258, 277
_COMPRESSION, _SAMPLE_FORMAT = 259, 339
_COMPRESSIONS = {1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946, 34925, 50000}
"""Those that Pillow reads: none, three kinds of fax, LZW, two of JPEG, Deflate, PackBits, Deflate, LZMA and
Zstandard."""
_COMPLEX = {5, 6}
"""Formats of a sample with a real and an imaginary part, of integers and of floating point."""
_STRIPS_AND_TILES = ((273, 279), (324, 325))
"""Tags of the offsets and byte counts."""


@dataclass(frozen=True)
class TiffHeader:
    """Main properties of a TIFF, and its tags."""

    size_px: tuple[int, int]
    """(width, height)."""
    bits: int
    """Largest number of bits of a sample."""
    samples: int
    """Number of samples of a pixel."""
    decoded_bytes: int
    """Number of bytes of the decoded pixels."""
    end: int
    """Number of bytes that the file must have."""
    exif: Pillow.Exif


def tiff_header(file: IO[bytes]) -> TiffHeader:
    """Read the header of an open TIFF. Raises ``ValueError`` or another exception for a damaged one."""
    exif = Pillow.Exif()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged tags
        exif.load_from_fp(file)
        tags = dict(exif)
    ends = [
        int(offset) + int(count)
        for offsets, counts in _STRIPS_AND_TILES
        for offset, count in zip(_values(tags.get(offsets)), _values(tags.get(counts)), strict=True)
    ]
    if not ends or _WIDTH not in tags or _HEIGHT not in tags:
        raise ValueError("no pixels")
    width, height, samples = int(tags[_WIDTH]), int(tags[_HEIGHT]), int(tags.get(_SAMPLES, 1))
    bits = max(map(int, _values(tags.get(_BITS, 1))))
    decoded_bytes = width * height * min(samples, 3) * -(-bits // 8)
    return TiffHeader((width, height), bits, samples, decoded_bytes, max(ends), exif)


def unusual_tiff(data: bytes) -> str:
    """Return why a whole TIFF is not read although it is sound; empty for one of a usual kind."""
    try:
        tags = tiff_header(io.BytesIO(data)).exif
    except Exception:  # noqa: BLE001  Pillow raises any exception for a damaged file
        return ""
    if (method := tags.get(_COMPRESSION, 1)) not in _COMPRESSIONS:
        return f"a TIFF of a compression that is not read (tag 259: {method})"
    return "a TIFF of complex numbers" if {*_values(tags.get(_SAMPLE_FORMAT))} & _COMPLEX else ""


def gdal_pixels(data: bytes) -> tuple[Raw, bool]:
    """Return all bits of the pixels of a TIFF, (h, w) or (h, w, 3) RGB, and whether they are integers.

    Of more than four samples or of two, the first alone is read; alpha is dropped. Pixels marked as missing
    are NaN. Where zero is white, numbers are inverted. Raises ``OSError`` for a damaged file.
    """
    from rasterio.errors import NotGeoreferencedWarning, RasterioError
    from rasterio.io import MemoryFile

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with MemoryFile(data) as memory, memory.open(driver="GTiff") as picture:
                bands = [1, 2, 3] if picture.count in (3, 4) else [1]
                pixels, missing = picture.read(bands), picture.nodata
                zero_is_white = "MINISWHITE" in picture.tags(ns="IMAGE_STRUCTURE")
                bits = picture.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 8 * pixels.dtype.itemsize)
        except RasterioError as error:
            raise OSError("damaged") from error
    if pixels.dtype.kind not in "uif":
        raise OSError("damaged")
    is_integer = pixels.dtype.kind in "ui"
    is_missing = None if missing is None else pixels == missing
    if zero_is_white and pixels.dtype.kind == "u":
        pixels = (1 << int(bits)) - 1 - pixels
    if is_missing is not None and is_missing.any():
        pixels = np.where(is_missing, np.nan, pixels)
    colour = np.ascontiguousarray(np.moveaxis(pixels, 0, -1)) if len(pixels) == 3 else pixels[0]
    return colour, is_integer


def _values(tag: object) -> tuple[int, ...]:
    return tag if isinstance(tag, tuple) else () if tag is None else (tag,)
