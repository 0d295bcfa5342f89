"""MCAP files of any message encoding: schemas, channels, and an index of the messages.

A file is a sequence of records: an operation code, a length, and content. Chunks hold records, compressed or
not. The file is read through once; its own index is not needed, so a file that was cut short is read too.
Source: mcap.dev, "MCAP Format Specification".
"""

from __future__ import annotations

import mmap
import struct
import zlib
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END, _FOOTER = 3, 4, 5, 6, 15, 2
_RECORD_HEADER = struct.Struct("<BQ")
_MESSAGE_HEADER = struct.Struct("<HIQQ")
_CHUNK_HEADER = struct.Struct("<QQQI")
_DECOMPRESSION = {"lz4": "lz4.frame", "zstd": "backports.zstd"}
"""Name of a compression -> the module whose ``decompress`` undoes it."""
_KEPT_CHUNKS = 4
"""Chunks that are held decompressed; recorders may write a few in turn."""


@dataclass(frozen=True)
class Schema:
    """The declaration of a type of message."""

    name: str
    encoding: str
    data: bytes


@dataclass
class McapChannel:
    """A channel, and the places of its messages."""

    topic: str
    encoding: str
    """Encoding of its messages: ``json``, ``protobuf`` and so on."""
    schema: Schema | None
    times_ns: array[int] = field(default_factory=lambda: array("q"))
    chunks: array[int] = field(default_factory=lambda: array("q"))
    """Place of the chunk of each message in the file; -1 for a message outside of chunks."""
    places: array[int] = field(default_factory=lambda: array("q"))
    """Place of each message's data in its chunk, or in the file."""
    sizes: array[int] = field(default_factory=lambda: array("q"))


class _Fields:
    """Reads the fields of a record in order. Raises ``ValueError`` where they end too early."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self, letter: str) -> int:
        size = struct.calcsize("<" + letter)
        return int(struct.unpack("<" + letter, self._take(size))[0])

    def blob(self) -> bytes:
        return self._take(self.number("I"))

    def text(self) -> str:
        return self.blob().decode("utf-8", errors="replace")

    def _take(self, size: int) -> bytes:
        if self._at + size > len(self._data):
            raise ValueError("a record is shorter than its fields")
        self._at += size
        return self._data[self._at - size : self._at]


class McapFile:
    """An open file. Raises ``ImportError`` for a compression whose package is missing."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self.channels: dict[int, McapChannel] = {}
        self.lost_bytes = 0
        """Bytes of records that are damaged or cut short."""
        self.has_end = False
        """Whether the recorder wrote the record that ends the data."""
        self._schemas: dict[int, Schema] = {}
        self._chunk = lru_cache(_KEPT_CHUNKS)(self._decompressed)
        self._index()

    def messages(
        self, channels: Sequence[McapChannel], start_ns: int | None = None
    ) -> Iterator[tuple[McapChannel, int, bytes]]:
        """Yield channel, time of recording and data in order of time; of equal times, in that of the file."""
        owner = np.repeat(np.arange(len(channels)), [len(each.times_ns) for each in channels])
        times, chunks, places, sizes = (
            _joined([getattr(each, name) for each in channels])
            for name in ("times_ns", "chunks", "places", "sizes")
        )
        order = np.lexsort((places, chunks, times))
        if start_ns is not None:
            order = order[times[order] >= start_ns]
        for k in order.tolist():
            chunk_at, place = int(chunks[k]), int(places[k])
            source = self._data if chunk_at < 0 else self._chunk(chunk_at)
            yield channels[owner[k]], int(times[k]), bytes(source[place : place + int(sizes[k])])

    def _index(self) -> None:
        """Walk through the records of the file, and through those of each chunk."""
        at, end = len(MAGIC), len(self._data)
        while at + _RECORD_HEADER.size <= end:
            code, size = _RECORD_HEADER.unpack_from(self._data, at)
            content = at + _RECORD_HEADER.size
            if content + size > end:
                break
            if code in (_DATA_END, _FOOTER):
                self.has_end = True
                return
            try:
                if code == _CHUNK:
                    self._index_chunk(content, size)
                else:
                    self._record(code, self._data, content, size, -1)
            except ValueError:
                self.lost_bytes += size
            at = content + size
        self.lost_bytes += max(end - at, 0)

    def _index_chunk(self, content: int, size: int) -> None:
        records = self._chunk(content)
        at = 0
        while at + _RECORD_HEADER.size <= len(records):
            code, length = _RECORD_HEADER.unpack_from(records, at)
            place = at + _RECORD_HEADER.size
            if place + length > len(records):
                raise ValueError("a record leads out of its chunk")
            self._record(code, records, place, length, content)
            at = place + length

    def _decompressed(self, content: int) -> bytes:
        """Return the records of the chunk whose content begins at a place. Raises ``ValueError``."""
        (length,) = struct.unpack_from("<Q", self._data, content - 8)
        fields = _Fields(self._data[content : content + min(length, 256)])
        for _ in range(2):
            fields.number("Q")  # times of the first and the last message
        size, checksum, compression = fields.number("Q"), fields.number("I"), fields.text()
        stored = fields.number("Q")
        start = content + _CHUNK_HEADER.size + 4 + len(compression.encode()) + 8
        if start + stored > content + length:
            raise ValueError("a chunk is shorter than its records")
        records = decompress(self._data[start : start + stored], compression)
        if len(records) != size or (checksum and zlib.crc32(records) != checksum):
            raise ValueError("a chunk is damaged")
        return records

    def _record(self, code: int, data: bytes | mmap.mmap, at: int, size: int, chunk_at: int) -> None:
        if code == _SCHEMA:
            fields = _Fields(data[at : at + size])
            number = fields.number("H")
            self._schemas[number] = Schema(fields.text(), fields.text(), fields.blob())
        elif code == _CHANNEL:
            fields = _Fields(data[at : at + size])
            number, schema = fields.number("H"), self._schemas.get(fields.number("H"))
            self.channels.setdefault(number, McapChannel(fields.text(), fields.text(), schema))
        elif code == _MESSAGE:
            if size < _MESSAGE_HEADER.size:
                raise ValueError("a message is shorter than its header")
            number, _, time_ns, _ = _MESSAGE_HEADER.unpack_from(data, at)
            if number not in self.channels or time_ns >= 2**63:
                raise ValueError("a message has no channel, or no time")
            channel = self.channels[number]
            channel.times_ns.append(time_ns)
            channel.chunks.append(chunk_at)
            channel.places.append(at + _MESSAGE_HEADER.size)
            channel.sizes.append(size - _MESSAGE_HEADER.size)


def _joined(parts: Sequence[array[int]]) -> NDArray[np.int64]:
    return np.concatenate([np.array(part, dtype=np.int64) for part in parts] or [np.zeros(0, np.int64)])


def decompress(data: bytes, compression: str) -> bytes:
    """Return decompressed bytes.

    Raises ``ValueError`` for damaged ones, and ``ImportError`` without the package of the compression.
    """
    if compression == "":
        return data
    if compression not in _DECOMPRESSION:
        raise ValueError(f"the compression {compression[:20]!r} is not known")
    opener = import_module(_DECOMPRESSION[compression]).decompress
    try:
        return bytes(opener(data))
    except Exception as error:  # the libraries' errors have no common class
        raise ValueError("a chunk is damaged") from error
