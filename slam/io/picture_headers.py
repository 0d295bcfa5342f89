"""Headers of pictures (PNG, JPEG or TIFF) from untrusted files: the size, before anything is decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from slam.io.content import content_name
from slam.io.tiff import MAGIC as TIFF_MAGIC
from slam.io.tiff import tiff_header

MAX_PIXELS = 89_000_000
"""Largest number of pixels, just below the limit at which Pillow reports a decompression bomb."""
_MOST_SAMPLES = 4
"""Largest number of samples of a pixel that Pillow reads: three colours and transparency."""
MAX_BYTES = 1 << 29
HEADER_BYTES = 1 << 18
"""Number of bytes that contain the EXIF, XMP and maker's blocks that precede the size in a JPEG."""
PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_SIZE_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class UnreadableImageError(Exception):
    """A picture cannot be used. The message is the reason, short enough to count pictures by it."""


@dataclass(frozen=True)
class PictureHeader:
    """Size and depth of a picture, before it is decoded."""

    size_px: tuple[int, int]
    is_deep: bool = False
    """Whether Pillow alone does not read all of its pixels: more than 8 bits or, in a TIFF, than four
    samples."""
    of_samples: int = 0
    """Number of samples of a pixel of which the first alone is read; 0 where all are read."""


def encoded_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) of a PNG or JPEG by its header. Raises ``UnreadableImageError``."""
    return encoded_header(data).size_px


def check_encoded(data: bytes, size_px: tuple[int, int]) -> None:
    """Raise ``UnreadableImageError`` where data are no PNG or JPEG of that size (width, height), by their
    header.
    """
    check_size(encoded_size(data), size_px)


def check_size(size: tuple[int, int], size_px: tuple[int, int] | None) -> None:
    """Raise ``UnreadableImageError`` where a size (width, height) differs from the one that is expected."""
    if size_px is not None and size != size_px:
        raise UnreadableImageError(f"is {size[0]} x {size[1]} px, not {size_px[0]} x {size_px[1]}")


def image_size(path: Path) -> tuple[int, int]:
    """Return (width, height) from the header alone. Raises ``UnreadableImageError``."""
    return picture_header(path).size_px


def picture_header(path: Path) -> PictureHeader:
    """Return the header of a file. Raises ``UnreadableImageError``."""
    head = read_bytes(path, HEADER_BYTES, whole=False)
    return _checked(_tiff_header(path)) if head.startswith(TIFF_MAGIC) else encoded_header(head)


def encoded_header(data: bytes) -> PictureHeader:
    """Return the header of the content of a PNG or JPEG file. Raises ``UnreadableImageError``."""
    head = data[:HEADER_BYTES]
    if head.startswith(PNG) and head[12:16] == b"IHDR" and len(head) >= 25:
        header = PictureHeader(struct.unpack(">II", head[16:24]), head[24] == 16)
    elif head.startswith(b"\xff\xd8"):
        header = PictureHeader(_jpeg_size(head))
    else:
        raise UnreadableImageError(_format_reason(head))
    return _checked(header)


def _checked(header: PictureHeader) -> PictureHeader:
    """Return the header, or raise ``UnreadableImageError`` for an impossible size."""
    width, height = header.size_px
    if width <= 0 or height <= 0:
        raise UnreadableImageError("damaged")
    if width * height > MAX_PIXELS:
        raise UnreadableImageError(f"is {width} x {height} px, more than {MAX_PIXELS // 10**6} million")
    return header


def _tiff_header(path: Path) -> PictureHeader:
    try:
        with path.open("rb") as file:
            header = tiff_header(file)
        complete = header.end <= path.stat().st_size
    except OSError as error:
        raise UnreadableImageError(
            f"unreadable ({error.strerror})" if error.strerror else "damaged"
        ) from error
    except Exception as error:  # Pillow raises any exception for a damaged file
        raise UnreadableImageError("damaged") from error
    if not complete:
        raise UnreadableImageError("truncated")
    if header.decoded_bytes > MAX_BYTES:
        raise UnreadableImageError(f"needs more than {MAX_BYTES >> 20} MB")
    of_samples = header.samples if header.samples > _MOST_SAMPLES else 0
    return PictureHeader(header.size_px, header.bits > 8 or of_samples > 0, of_samples)


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


def suffix_of(data: bytes) -> str:
    """Return the suffix of a picture's file, by its content."""
    return ".png" if data.startswith(PNG) else ".jpg"


def read_bytes(path: Path, limit: int, whole: bool = True) -> bytes:
    """Return the content of a file, or its first ``limit`` bytes where it need not be ``whole``.

    Raises ``UnreadableImageError``, also for a larger file.
    """
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
    if PNG.startswith(head[:8]) or head.startswith(PNG):
        return "truncated"
    name = content_name(head)
    return f"is {name}, no PNG, JPEG or TIFF" if name else "no PNG, JPEG or TIFF"
