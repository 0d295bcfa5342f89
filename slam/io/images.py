"""Reading one picture that may be anything: its header is checked before a pixel is decoded.

Pillow decodes, because it refuses a picture that ends early where OpenCV fills the rest with grey. EXIF
orientation is not applied: the intrinsics belong to the pixels as the sensor gave them.
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
"""Largest picture read, in pixels: just below where Pillow suspects a decompression bomb."""
MAX_BYTES = 1 << 29
HEADER_BYTES = 1 << 18
"""Enough for the EXIF, XMP and maker's blocks that precede the size in a JPEG."""

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_SIZE_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_TAG_BLOCKS = re.compile(rb"(\xff[\xe1\xe2]..)(Exif|MPF\0)", re.DOTALL)
"""Start of a JPEG's Exif and multi-picture blocks."""
_FOREIGN = {b"II*\0": "a TIFF", b"MM\0*": "a TIFF", b"GIF8": "a GIF", b"RIFF": "a WebP", b"BM": "a BMP"}


_DEPTHS = (8, 10, 12, 14, 16)
"""Bits a pixel that cameras put into files of 16."""


class UnreadableImageError(Exception):
    """A picture that cannot be used; the message is the reason, short enough to count by."""


@dataclass
class PictureFiles:
    """Loads picture k of a list of files; can be sent to another process."""

    paths: tuple[Path, ...]
    size_px: tuple[int, int] | None
    """(width, height) that every picture must have; None takes any."""
    depth_bits: int | None = None
    """Common bit depth of 16-bit files, so that none is brighter than its neighbours; None: each file has
    its own."""
    failures: dict[int, str] = field(default_factory=dict)
    """Why picture k could not be read, for those that were asked for and could not."""

    def __call__(self, k: int) -> Image | None:
        """Picture k, or None with the reason kept in ``failures``."""
        try:
            return read_image(self.paths[k], self.size_px, self.depth_bits)
        except UnreadableImageError as reason:
            self.failures[k] = str(reason)
            return None


def read_image(path: Path, size_px: tuple[int, int] | None = None, depth_bits: int | None = None) -> Image:
    """A PNG or JPEG as (h, w, 3) BGR or (h, w) grey, 8 bit.

    Of 16-bit files the lowest ``depth_bits`` count, or as many as the picture's brightest value needs where
    None is given; the upper 8 of them are kept. 1-bit becomes 0 and 255, palettes are resolved, alpha is
    dropped. Raises ``UnreadableImageError`` where it is missing, damaged, too large, or not of ``size_px``.
    """
    size = image_size(path)
    if size_px is not None and size != size_px:
        raise UnreadableImageError(f"is {size[0]} x {size[1]} px, not {size_px[0]} x {size_px[1]}")
    data = _bytes(path, MAX_BYTES)
    try:
        if data.startswith(_PNG):
            # Pillow checks no CRC while decoding: a flipped bit would pass unseen.
            Pillow.open(io.BytesIO(data), formats=["PNG"]).verify()
        else:
            # Pillow would read the tags, which are not wanted here, and warn of those that are damaged.
            data = _TAG_BLOCKS.sub(rb"\1none", data[:HEADER_BYTES]) + data[HEADER_BYTES:]
        with Pillow.open(io.BytesIO(data), formats=["PNG", "JPEG"]) as picture:
            pixels = _pixels(picture)
        if _is_deep(data):
            deep = _sixteen_bit(data, grey=pixels.ndim == 2)
            return _eight_bit(deep, depth_bits or bit_depth_of(int(deep.max())))
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
    """(width, height) from the header alone. Raises ``UnreadableImageError``."""
    head = _bytes(path, HEADER_BYTES, whole=False)
    if head.startswith(_PNG) and head[12:16] == b"IHDR" and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
    elif head.startswith(b"\xff\xd8"):
        width, height = _jpeg_size(head)
    else:
        raise UnreadableImageError(_not_a_picture(head))
    if width <= 0 or height <= 0:
        raise UnreadableImageError("damaged")
    if width * height > MAX_PIXELS:
        raise UnreadableImageError(f"is {width} x {height} px, more than {MAX_PIXELS // 10**6} million")
    return width, height


def _jpeg_size(head: bytes) -> tuple[int, int]:
    """Walk the marker segments to the frame header (ITU T.81, annex B)."""
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
    """The largest value in a 16-bit PNG; None for pictures of 8 bits. Raises ``UnreadableImageError``."""
    if not _is_deep(_bytes(path, 32, whole=False)):
        return None
    read_image(path)  # refuses what is damaged
    return int(_sixteen_bit(_bytes(path, MAX_BYTES), grey=False).max())


def bit_depth_of(value: int) -> int:
    """Bits a pixel of the camera whose brightest value this is."""
    return next(bits for bits in _DEPTHS if value < 1 << bits)


def _is_deep(head: bytes) -> bool:
    """Whether it is a PNG of 16 bits, by its header."""
    return head.startswith(_PNG) and head[24:25] == b"\x10"


def _sixteen_bit(data: bytes, grey: bool) -> NDArray[np.uint16]:
    """All bits of a picture that Pillow has found whole; of colours it would keep the upper byte alone."""
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


def _not_a_picture(head: bytes) -> str:
    if not head.strip(b"\0"):
        return "empty" if not head else "zeroed"
    if _PNG.startswith(head[:8]) or head.startswith(_PNG):
        return "truncated"
    foreign = next((name for magic, name in _FOREIGN.items() if head.startswith(magic)), "neither")
    return "neither a PNG nor a JPEG" if foreign == "neither" else f"is {foreign}, not a PNG or JPEG"
