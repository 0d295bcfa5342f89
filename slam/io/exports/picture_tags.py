"""Change of Exif data and XMP packet in the bytes of a JPEG, PNG or TIFF; pixels stay byte by byte.

Sources: CIPA DC-008-2019 (Exif 2.32), section 4.7; W3C, PNG (2022), section 11.3; Adobe, XMP Specification
Part 3 (2016), section 1.1.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator

from slam.io.exports.tiff_tags import EMPTY, TiffTags, bytes_value
from slam.io.tiff import MAGIC as TIFF_MAGIC
from slam.io.tiff import XMP_TAG

ChangeTags = Callable[[TiffTags], None]
ChangePacket = Callable[[bytes], bytes]

_EXIF, _XMP = b"Exif\0\0", b"http://ns.adobe.com/xap/1.0/\0"
_APP0, _APP1, _SCAN = 0xE0, 0xE1, 0xDA
_LARGEST_SEGMENT = 0xFFFF - 2
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_XMP = b"XML:com.adobe.xmp\0\0\0\0\0"
"""Keyword of an XMP packet that is not compressed, without language and translation."""


def with_tags(picture: bytes, tags: ChangeTags, packet: ChangePacket) -> bytes:
    """Return the bytes of a picture with changed Exif data, and a changed XMP packet if it has one.

    Raises ``ValueError`` with the reason for a picture that is damaged or has no room.
    """
    if picture.startswith(TIFF_MAGIC):
        return _tiff(picture, tags, packet)
    if picture.startswith(_PNG):
        return _PNG + b"".join(_png_chunks(picture, tags, packet))
    if picture.startswith(b"\xff\xd8"):
        return _jpeg(picture, tags, packet)
    raise ValueError("neither JPEG, PNG nor TIFF")


def _changed(exif: bytes, tags: ChangeTags) -> bytes:
    structure = TiffTags(exif)
    tags(structure)
    return structure.to_bytes()


def _tiff(picture: bytes, tags: ChangeTags, packet: ChangePacket) -> bytes:
    structure = TiffTags(picture)
    tags(structure)
    if found := structure.value_bytes(XMP_TAG):
        structure.set(XMP_TAG, bytes_value(packet(found)))
    return structure.to_bytes()


def _jpeg(picture: bytes, tags: ChangeTags, packet: ChangePacket) -> bytes:
    segments: list[tuple[int, bytes]] = []
    at = 2
    while True:
        if at + 4 > len(picture) or picture[at] != 0xFF:
            raise ValueError("damaged before its pixels")
        marker = picture[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker == _SCAN:
            break
        end = at + 2 + int.from_bytes(picture[at + 2 : at + 4], "big")
        segments.append((marker, picture[at + 4 : end]))
        at = end
    if not any(marker == _APP1 and content.startswith(_EXIF) for marker, content in segments):
        behind = int(bool(segments) and segments[0][0] == _APP0)
        segments.insert(behind, (_APP1, _EXIF + EMPTY))
    written = [_segment(marker, _jpeg_content(marker, content, tags, packet)) for marker, content in segments]
    return picture[:2] + b"".join(written) + picture[at:]


def _jpeg_content(marker: int, content: bytes, tags: ChangeTags, packet: ChangePacket) -> bytes:
    if marker == _APP1 and content.startswith(_EXIF):
        return _EXIF + _changed(content[len(_EXIF) :], tags)
    if marker == _APP1 and content.startswith(_XMP):
        return _XMP + packet(content[len(_XMP) :])
    return content


def _segment(marker: int, content: bytes) -> bytes:
    if len(content) > _LARGEST_SEGMENT:
        raise ValueError("no room for more tags")
    return bytes((0xFF, marker)) + (len(content) + 2).to_bytes(2, "big") + content


def _png_chunks(picture: bytes, tags: ChangeTags, packet: ChangePacket) -> Iterator[bytes]:
    has_exif, at = False, len(_PNG)
    while at < len(picture):
        size, kind = int.from_bytes(picture[at : at + 4], "big"), picture[at + 4 : at + 8]
        content = picture[at + 8 : at + 8 + size]
        if at + 12 + size > len(picture):
            raise ValueError("cut short")
        if kind == b"IDAT" and not has_exif:
            has_exif = True
            yield _chunk(b"eXIf", _changed(EMPTY, tags))
        if kind == b"eXIf":
            has_exif = True
            yield _chunk(kind, _changed(content, tags))
        elif kind == b"iTXt" and content.startswith(_PNG_XMP):
            yield _chunk(kind, _PNG_XMP + packet(content[len(_PNG_XMP) :]))
        else:
            yield picture[at : at + 12 + size]
        at += 12 + size


def _chunk(kind: bytes, content: bytes) -> bytes:
    checksum = zlib.crc32(kind + content)
    return len(content).to_bytes(4, "big") + kind + content + checksum.to_bytes(4, "big")
