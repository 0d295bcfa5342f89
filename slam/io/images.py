"""Reading of one picture from an untrusted file. The header is checked before any pixel is decoded.

Pillow decodes, because it refuses a truncated picture, where OpenCV fills the rest with grey. EXIF
orientation is not applied, as the intrinsics belong to the pixels in sensor order.
"""

from __future__ import annotations

import io
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from slam.core.flight import Image

MAX_PIXELS = 89_000_000
"""Largest number of pixels, just below the limit at which Pillow reports a decompression bomb."""
MAX_BYTES = 1 << 29
HEADER_BYTES = 1 << 18
"""Number of bytes that contain the EXIF, XMP and maker's blocks that precede the size in a JPEG."""

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_SIZE_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_TAG_BLOCKS = re.compile(rb"(\xff[\xe1\xe2]..)(Exif|MPF\0)", re.DOTALL)
"""Start of a JPEG's Exif and multi-picture blocks."""
_OTHER_FORMATS = {b"II*\0": "a TIFF", b"MM\0*": "a TIFF", b"GIF8": "a GIF", b"RIFF": "a WebP", b"BM": "a BMP"}


_DEPTHS = (8, 10, 12, 14, 16)
"""Bit depths of cameras whose files have 16 bits per pixel."""


class UnreadableImageError(Exception):
    """A picture cannot be used. The message is the reason, short enough to count pictures by it."""


@dataclass
class PictureFiles:
    """Loader of picture k of a list of files. It can be sent to another process."""

    paths: tuple[Path, ...]
    size_px: tuple[int, int] | None
    """(width, height) that every picture must have; None allows any size."""
    depth_bits: int | None = None
    """Common bit depth of 16-bit files, so that none is brighter than its neighbours; None: each file has
    its own."""
    failures: dict[int, str] = field(default_factory=dict)
    """Reason for each picture k that was requested and could not be read."""

    def __call__(self, k: int) -> Image | None:
        """Return picture k, or None with the reason in ``failures``."""
        try:
            return read_image(self.paths[k], self.size_px, self.depth_bits)
        except UnreadableImageError as reason:
            self.failures[k] = str(reason)
            return None


def read_image(path: Path, size_px: tuple[int, int] | None = None, depth_bits: int | None = None) -> Image:
    """Return a PNG or JPEG as (h, w, 3) BGR or (h, w) grey, 8 bit.

    In 16-bit files the lowest ``depth_bits`` are used, or as many as the brightest value needs if it is None;
    the upper 8 of them are returned. 1-bit pixels become 0 and 255, palettes are resolved, and alpha is
    dropped. Raises ``UnreadableImageError`` if the file is missing, damaged, too large, or not of
    ``size_px``.
    """
    size = image_size(path)
    if size_px is not None and size != size_px:
        raise UnreadableImageError(f"is {size[0]} x {size[1]} px, not {size_px[0]} x {size_px[1]}")
    data = _bytes(path, MAX_BYTES)
    try:
        if data.startswith(_PNG):
            # Pillow checks no CRC while decoding, so a flipped bit would be undetected.
            Pillow.open(io.BytesIO(data), formats=["PNG"]).verify()
        else:
            # The tags are removed, as they are not needed and Pillow warns of damaged ones.
            data = _TAG_BLOCKS.sub(rb"\1none", data[:HEADER_BYTES]) + data[HEADER_BYTES:]
        with Pillow.open(io.BytesIO(data), formats=["PNG", "JPEG"]) as picture:
            pixels = _pixels(picture)
        if _is_16_bit(data):
            pixels_16_bit = _sixteen_bit(data, grey=pixels.ndim == 2)
            return _eight_bit(pixels_16_bit, depth_bits or bit_depth_of(int(pixels_16_bit.max())))
        return pixels
    except UnreadableImageError:
        raise
    except (
        OSError,
        ValueError,
        SyntaxError,
        EOFError,
        struct.error,
        OverflowError,
        IndexError,
        TypeError,
    ) as e:
        reason = "truncated" if "truncated" in str(e).lower() else "damaged"
        raise UnreadableImageError(reason) from e


def image_size(path: Path) -> tuple[int, int]:
    """Return (width, height) from the header alone. Raises ``UnreadableImageError``."""
    head = _bytes(path, HEADER_BYTES, whole=False)
    if head.startswith(_PNG) and head[12:16] == b"IHDR" and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
    elif head.startswith(b"\xff\xd8"):
        width, height = _jpeg_size(head)
    else:
        raise UnreadableImageError(_format_reason(head))
    if width <= 0 or height <= 0:
        raise UnreadableImageError("damaged")
    if width * height > MAX_PIXELS:
        raise UnreadableImageError(f"is {width} x {height} px, more than {MAX_PIXELS // 10**6} million")
    return width, height


def _jpeg_size(head: bytes) -> tuple[int, int]:
    """Return the size in the frame header after the marker segments (ITU T.81, annex B)."""
    at = 2
    while at + 9 <= len(head):
        if head[at] != 0xFF:
            break
        marker = head[at + 1]
        if marker == 0xFF:
            at += 1
        elif marker in _JPEG_SIZE_MARKERS:
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:
            at += 2
        else:
            at += 2 + struct.unpack(">H", head[at + 2 : at + 4])[0]
    raise UnreadableImageError("truncated" if len(head) < HEADER_BYTES else "damaged")


def max_value(path: Path) -> int | None:
    """Return the largest value of a 16-bit PNG, or None for 8 bits. Raises ``UnreadableImageError``."""
    if not _is_16_bit(_bytes(path, 32, whole=False)):
        return None
    read_image(path)  # this raises for a damaged picture
    return int(_sixteen_bit(_bytes(path, MAX_BYTES), grey=False).max())


def bit_depth_of(value: int) -> int:
    """Return the bit depth of a camera from its brightest value."""
    return next(bits for bits in _DEPTHS if value < 1 << bits)


def _is_16_bit(head: bytes) -> bool:
    """Return whether the header is that of a PNG with 16 bits."""
    return head.startswith(_PNG) and head[24:25] == b"\x10"


def _sixteen_bit(data: bytes, grey: bool) -> NDArray[np.uint16]:
    """Return all bits of a picture that Pillow has verified. Pillow itself keeps only the upper byte of
    colours.
    """
    channels = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | channels)
    if pixels is None:
        raise UnreadableImageError("damaged")
    return np.asarray(pixels, dtype=np.uint16)


def _eight_bit(pixels: NDArray[np.uint16], depth_bits: int) -> Image:
    return np.asarray(np.minimum(pixels >> (depth_bits - 8), 255), dtype=np.uint8)


def _pixels(picture: Pillow.Image) -> Image:
    mode = picture.mode
    if mode.startswith("I;16"):
        return (np.asarray(picture).astype(np.uint16) >> 8).astype(np.uint8)
    if mode in ("I", "F"):
        raise UnreadableImageError("has 32-bit or float pixels; convert to 8 bit")
    if mode in ("1", "L", "LA", "La"):
        return np.array(picture.convert("L"))
    return np.ascontiguousarray(np.asarray(picture.convert("RGB"))[..., ::-1])


def _bytes(path: Path, limit: int, whole: bool = True) -> bytes:
    try:
        if not path.is_file():
            raise UnreadableImageError("missing" if not path.exists() else "not a file")
        with open(path, "rb") as file:
            data = file.read(limit + 1 if whole else limit)
    except OSError as error:
        raise UnreadableImageError(f"unreadable ({error.strerror})") from error
    if len(data) > limit:
        raise UnreadableImageError(f"larger than {limit >> 20} MB")
    return data


def _format_reason(head: bytes) -> str:
    if not head.strip(b"\0"):
        return "empty" if not head else "zeroed"
    if _PNG.startswith(head[:8]) or head.startswith(_PNG):
        return "truncated"
    format_name = next((name for magic, name in _OTHER_FORMATS.items() if head.startswith(magic)), "neither")
    return "neither a PNG nor a JPEG" if format_name == "neither" else f"is {format_name}, not a PNG or JPEG"
