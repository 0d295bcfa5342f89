"""ROS 2 recordings in MCAP that were cut short, as after a crash of the recorder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)

from slam.io.recordings.mcap_file import MAGIC, McapChannel, McapFile

DEFINITIONS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""Encoding of a schema -> how ``rosbags`` names it."""


class CutMcapReader(AbstractContextManager["CutMcapReader"]):
    """A reader for ``rosbags.highlevel.AnyReader`` that makes the index itself."""

    def __init__(self, path: Path) -> None:
        self._file = McapFile(path)
        self._channels: dict[int, McapChannel] = {
            number: each for number, each in self._file.channels.items() if each.schema is not None
        }
        self.connections = [self._connection(number) for number in self._channels]

    @property
    def lost_bytes(self) -> int:
        """Bytes of records that are damaged or cut short."""
        return self._file.lost_bytes

    @property
    def start_time(self) -> int:
        """Time of the first complete message in nanoseconds."""
        return min((min(each.times_ns) for each in self._channels.values() if each.times_ns), default=0)

    @property
    def end_time(self) -> int:
        """Time after the last complete message in nanoseconds."""
        return max((max(each.times_ns) + 1 for each in self._channels.values() if each.times_ns), default=1)

    def __exit__(self, *error: object) -> None:
        """Close nothing: the file is held by its mapping."""

    def messages(
        self, connections: Sequence[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording and data, in the order of time."""
        wanted = {each.id: each for each in connections or self.connections}
        channels = [self._channels[number] for number in wanted]
        owner = {id(self._channels[number]): each for number, each in wanted.items()}
        for channel, time_ns, data in self._file.messages(channels, start):
            if stop is None or time_ns < stop:
                yield owner[id(channel)], time_ns, data

    def _connection(self, number: int) -> Connection:
        channel = self._channels[number]
        assert channel.schema is not None
        form = DEFINITIONS.get(channel.schema.encoding, MessageDefinitionFormat.NONE)
        return Connection(
            id=number,
            topic=channel.topic,
            msgtype=channel.schema.name,
            msgdef=MessageDefinition(form, channel.schema.data.decode("utf-8", "replace")),
            digest="",
            msgcount=len(channel.times_ns),
            ext=ConnectionExtRosbag2(channel.encoding, []),
            owner=self,
        )


def is_mcap(path: Path) -> bool:
    """Return whether a path is a file in MCAP."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC
