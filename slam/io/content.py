"""Name of a file's format by its first bytes, for messages about a file of another kind."""

from __future__ import annotations

from pathlib import Path

_SIGNATURES: tuple[tuple[int, bytes, str], ...] = (
    (0, b"\x89PNG", "a PNG picture"),
    (0, b"\xff\xd8\xff", "a JPEG picture"),
    (0, b"II*\0", "a TIFF picture"),
    (0, b"MM\0*", "a TIFF picture"),
    (0, b"II+\0", "a BigTIFF picture"),
    (0, b"MM\0+", "a BigTIFF picture"),
    (0, b"GIF8", "a GIF picture"),
    (0, b"BM", "a BMP picture"),
    (8, b"WEBP", "a WebP picture"),
    (4, b"ftyphei", "a HEIC picture"),
    (4, b"ftypmif1", "a HEIC picture"),
    (4, b"ftypavif", "an AVIF picture"),
    (4, b"ftyp", "an MP4 video"),
    (4, b"moov", "an MP4 video"),
    (4, b"mdat", "an MP4 video"),
    (8, b"AVI ", "an AVI video"),
    (0, b"\x1aE\xdf\xa3", "a Matroska video"),
    (0, b"%PDF", "a PDF document"),
    (0, b"PK\x03\x04", "a ZIP archive"),
    (0, b"\x1f\x8b", "a gzip archive"),
    (0, b"BZh", "a bzip2 archive"),
    (0, b"\xfd7zXZ", "an xz archive"),
    (0, b"7z\xbc\xaf", "a 7z archive"),
    (0, b"Rar!", "a RAR archive"),
    (257, b"ustar", "a tar archive"),
    (0, b"SQLite format 3", "an SQLite database"),
    (0, b"\x89HDF", "an HDF5 file"),
    (0, b"\x93NUMPY", "a numpy array"),
    (0, b"#ROSBAG", "a ROS 1 bag"),
    (0, b"\x89MCAP0", "an MCAP recording"),
    (0, b"ULog\x01\x12\x35", "a PX4 log"),
    (0, b"<!DOCTYPE html", "an HTML page"),
    (0, b"<html", "an HTML page"),
    (0, b"<?xml", "an XML file"),
)
"""Offset, bytes and name with its article; the first that fits counts."""

_READ = ("a PNG picture", "a JPEG picture", "a TIFF picture")
"""Pictures that are read, unless they are damaged."""

HEAD_BYTES = max(at + len(mark) for at, mark, _ in _SIGNATURES)
"""Number of first bytes that ``content_name`` needs."""


def content_name(head: bytes) -> str:
    """Return what a file with these first bytes is, with its article, or "" where it is not recognised."""
    if not head:
        return "an empty file"
    if not head.strip(b"\0"):
        return "a file of zero bytes"
    return next((name for at, mark, name in _SIGNATURES if head.startswith(mark, at)), "")


def unreadable_reason(path: Path) -> str:
    """Return why a picture cannot be read: what the file holds instead, where that is recognised."""
    try:
        with path.open("rb") as file:
            found = content_name(file.read(HEAD_BYTES))
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not found or found in _READ:
        return "not a readable picture"
    if found.endswith("picture"):
        return f"{found}, which is not read; convert it to JPEG with its tags"
    return f"{found}, not a picture"
