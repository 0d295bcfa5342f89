"""Change of tags in a TIFF structure, which Exif data is too, without moving what it holds.

The new values and a new first directory are appended, and the header points to that directory. All offsets in
the file stay valid, also those in makers' notes and of the pixels. Source: Adobe, TIFF 6.0 (1992), section 2;
CIPA DC-008-2019 (Exif 2.32), section 4.6.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

GPS_DIRECTORY = 0x8825
"""Tag of the offset of the GPS directory."""
EMPTY = b"II*\0\x08\0\0\0\0\0\0\0\0\0"
"""A structure without any tag."""
BYTE, ASCII, LONG, RATIONAL = 1, 2, 4, 5
"""Types of values."""
_ENTRY_BYTES = 12
_INLINE_BYTES = 4
"""Longer values stand elsewhere, and the entry has their offset."""
_LARGEST_BYTES = 2**32 - 1


@dataclass(frozen=True)
class Value:
    """One value of a tag: its type, the number of items, and the items as a structure of ``format``."""

    kind: int
    count: int
    format: str
    """Letters of ``struct`` without the byte order."""
    items: tuple[int | bytes, ...]

    def packed(self, order: str) -> bytes:
        """Return the bytes in the byte order "<" or ">"."""
        return struct.pack(order + self.format, *self.items)


def text_value(text: str) -> Value:
    """Return an ASCII value with its final zero."""
    data = text.encode("ascii") + b"\0"
    return Value(ASCII, len(data), f"{len(data)}s", (data,))


def bytes_value(data: bytes) -> Value:
    """Return a value of single bytes."""
    return Value(BYTE, len(data), f"{len(data)}s", (data,))


def rational_value(*parts: tuple[int, int]) -> Value:
    """Return fractions of two unsigned integers each."""
    return Value(RATIONAL, len(parts), f"{2 * len(parts)}I", tuple(n for part in parts for n in part))


class TiffTags:
    """A TIFF structure to which values are appended. Raises ``ValueError`` for one that is damaged."""

    def __init__(self, data: bytes) -> None:
        self._order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4], "")
        if not self._order or len(data) < len(EMPTY):
            raise ValueError("no TIFF structure")
        self._data = bytearray(data)
        self._first, self._next = self._directory(self._number("I", 4))

    def value_bytes(self, tag: int) -> bytes:
        """Return the value of a tag of single bytes in the first directory; empty without it."""
        entry = self._first.get(tag)
        if entry is None:
            return b""
        kind, count = struct.unpack_from(self._order + "HI", entry, 2)
        if kind not in (BYTE, 7) or count <= _INLINE_BYTES:
            return b""
        at = struct.unpack_from(self._order + "I", entry, 8)[0]
        return bytes(self._data[at : at + count])

    def set(self, tag: int, value: Value) -> None:
        """Set a tag of the first directory."""
        self._first[tag] = self._entry(tag, value)

    def set_gps(self, values: Mapping[int, Value], drop: frozenset[int]) -> None:
        """Set tags of the GPS directory; tags in ``drop`` are removed, and the others stay."""
        entries: dict[int, bytes] = {}
        if (pointer := self._first.get(GPS_DIRECTORY)) is not None:
            entries, _ = self._directory(struct.unpack_from(self._order + "I", pointer, 8)[0])
        entries = {tag: entry for tag, entry in entries.items() if tag not in drop}
        entries |= {tag: self._entry(tag, value) for tag, value in values.items()}
        at = self._append(self._directory_bytes(entries, 0))
        self._first[GPS_DIRECTORY] = struct.pack(self._order + "HHII", GPS_DIRECTORY, LONG, 1, at)

    def to_bytes(self) -> bytes:
        """Return the structure with its changes."""
        at = self._append(self._directory_bytes(self._first, self._next))
        struct.pack_into(self._order + "I", self._data, 4, at)
        if len(self._data) > _LARGEST_BYTES:
            raise ValueError("more than 4 GB")
        return bytes(self._data)

    def _number(self, letter: str, at: int) -> int:
        try:
            return int(struct.unpack_from(self._order + letter, self._data, at)[0])
        except struct.error:
            raise ValueError("an offset leads out of the tags") from None

    def _directory(self, at: int) -> tuple[dict[int, bytes], int]:
        """Return the entries of a directory by tag, and the offset of the next directory."""
        count = self._number("H", at)
        end = at + 2 + _ENTRY_BYTES * count
        following = self._number("I", end)
        entries = [bytes(self._data[k : k + _ENTRY_BYTES]) for k in range(at + 2, end, _ENTRY_BYTES)]
        return {struct.unpack_from(self._order + "H", entry)[0]: entry for entry in entries}, following

    def _entry(self, tag: int, value: Value) -> bytes:
        data = value.packed(self._order)
        if len(data) > _INLINE_BYTES:
            data = struct.pack(self._order + "I", self._append(data))
        return struct.pack(self._order + "HHI", tag, value.kind, value.count) + data.ljust(4, b"\0")

    def _directory_bytes(self, entries: Mapping[int, bytes], following: int) -> bytes:
        count = struct.pack(self._order + "H", len(entries))
        ordered = b"".join(entries[tag] for tag in sorted(entries))
        return count + ordered + struct.pack(self._order + "I", following)

    def _append(self, data: bytes) -> int:
        """Append bytes at an even offset, as the standard wants it, and return the offset."""
        self._data += b"\0" * (len(self._data) % 2)
        self._data += data
        return len(self._data) - len(data)
