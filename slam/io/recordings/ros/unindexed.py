"""ROS 1 bags without an index, as after a crash of the recorder: the chunks are read through once.

A bag is a sequence of records. Chunks hold connections and messages; the index at the end only repeats where
they are. Source: ROS wiki, "Bags/Format/2.0".
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import Header, IndexData, ReaderError, RecordType, read_uint32

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


class UnindexedReader(Reader):
    """Reader of ``rosbags`` that makes the index itself; what lies behind a cut is lost."""

    lost_bytes: int = 0
    """Bytes at the end that hold no complete chunk."""

    def open(self) -> None:
        """Open the bag and walk through its records. Raises ``ReaderError`` where no chunk is complete."""
        path = Path(str(self.path))
        end = path.stat().st_size
        self.bio = file = path.open("rb")
        file.readline()
        at = file.tell()
        connections: dict[int, Connection] = {}
        try:
            while at < end:
                at = self._record(file, at, end, connections)
        except (ReaderError, AssertionError, ValueError, OSError, EOFError, RuntimeError):
            self.lost_bytes = end - at
        if not self.chunks:
            self.close()
            raise ReaderError("no chunk is complete")
        self.indexes = {number: sorted(entries) for number, entries in self.indexes.items()}
        self.connections = [
            each._replace(msgcount=len(self.indexes.get(number, ()))) for number, each in connections.items()
        ]
        self.indexes |= {each.id: [] for each in self.connections if each.id not in self.indexes}

    @property
    def start_time(self) -> int:
        """Time of the first message in nanoseconds."""
        return min((entries[0].time for entries in self.indexes.values() if entries), default=0)

    @property
    def end_time(self) -> int:
        """Time after the last message in nanoseconds."""
        return max((entries[-1].time + 1 for entries in self.indexes.values() if entries), default=1)

    def _record(self, file: BinaryIO, at: int, end: int, connections: dict[int, Connection]) -> int:
        """Read the record at a place, and return the place of the next one."""
        file.seek(at)
        kind = Header.read(file).get_uint8("op")
        size = read_uint32(file)
        following = file.tell() + size
        if following > end:
            raise ReaderError("the record is cut short")
        if kind == RecordType.CHUNK:
            file.seek(at)
            chunk = self.read_chunk()
            file.seek(chunk.datapos)
            content = BytesIO(chunk.decompressor(file.read(chunk.datasize)))
            self._index(content, at, connections)
            self.chunks[at] = chunk
        return following

    def _index(self, content: BytesIO, chunk_at: int, connections: dict[int, Connection]) -> None:
        """Add the connections and messages of one chunk to the index."""
        whole, size = self.bio, len(content.getvalue())
        while (at := content.tell()) < size:
            header = Header.read(content)
            if header.get_uint8("op") == RecordType.CONNECTION:
                content.seek(at)
                self.bio = content
                try:
                    connection = self.read_connection()
                finally:
                    self.bio = whole
                connections.setdefault(connection.id, connection)
                content.seek(at)
                Header.read(content)
            elif header.get_uint8("op") == RecordType.MSGDATA:
                entry = IndexData(header.get_time("time"), chunk_at, at)
                self.indexes.setdefault(header.get_uint32("conn"), []).append(entry)
            content.seek(read_uint32(content), os.SEEK_CUR)
